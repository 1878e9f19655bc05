// The functions that compilers call by themselves. newlib's read words from any address; here an
// unaligned access is trapped as the mistake that it would be everywhere else.
#include <cstddef>
#include <cstdint>

namespace {

constexpr std::size_t kWord = sizeof(std::uint32_t);

// A word that may stand for any object's bytes.
using Word [[gnu::may_alias]] = std::uint32_t;

bool aligned(const void* pointer) { return reinterpret_cast<std::uintptr_t>(pointer) % kWord == 0; }

}  // namespace

extern "C" {

void* memcpy(void* __restrict to, const void* __restrict from, std::size_t count) {
  auto* out = static_cast<std::uint8_t*>(to);
  const auto* in = static_cast<const std::uint8_t*>(from);
  if (aligned(out) && aligned(in)) {
    for (; count >= kWord; count -= kWord, out += kWord, in += kWord) {
      *reinterpret_cast<Word*>(out) = *reinterpret_cast<const Word*>(in);
    }
  }
  while (count-- > 0) *out++ = *in++;
  return to;
}

void* memset(void* to, int value, std::size_t count) {
  auto* out = static_cast<std::uint8_t*>(to);
  const auto byte = static_cast<std::uint8_t>(value);
  for (; count > 0 && !aligned(out); --count) *out++ = byte;
  const Word word = 0x01010101U * byte;
  for (; count >= kWord; count -= kWord, out += kWord) *reinterpret_cast<Word*>(out) = word;
  while (count-- > 0) *out++ = byte;
  return to;
}

int memcmp(const void* left, const void* right, std::size_t count) {
  const auto* a = static_cast<const std::uint8_t*>(left);
  const auto* b = static_cast<const std::uint8_t*>(right);
  for (; count > 0; --count, ++a, ++b) {
    if (*a != *b) return *a < *b ? -1 : 1;
  }
  return 0;
}

}  // extern "C"
