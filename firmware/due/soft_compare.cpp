// Comparisons of floats, which the compiler calls by these names. libgcc's take about 34
// instructions, these 15; a control tick makes some seventy of them.
#include <cstdint>
#include <cstring>

namespace {

constexpr std::uint32_t kInfinityDoubled = 0xFF000000;

struct Pair {
  std::int32_t left;
  std::int32_t right;
  bool ordered;
};

// Floats in their own order as integers; both zeros are 0.
std::int32_t ordinal(std::uint32_t bits) {
  const auto sign = static_cast<std::int32_t>(bits) >> 31;
  return (static_cast<std::int32_t>(bits & 0x7FFFFFFFU) ^ sign) - sign;
}

Pair pair(float left, float right) {
  std::uint32_t a = 0;
  std::uint32_t b = 0;
  std::memcpy(&a, &left, sizeof a);
  std::memcpy(&b, &right, sizeof b);
  return {ordinal(a), ordinal(b), a << 1U <= kInfinityDoubled && b << 1U <= kInfinityDoubled};
}

}  // namespace

extern "C" {

int __aeabi_fcmpeq(float left, float right) {
  const Pair p = pair(left, right);
  return p.ordered && p.left == p.right;
}

int __aeabi_fcmplt(float left, float right) {
  const Pair p = pair(left, right);
  return p.ordered && p.left < p.right;
}

int __aeabi_fcmple(float left, float right) {
  const Pair p = pair(left, right);
  return p.ordered && p.left <= p.right;
}

int __aeabi_fcmpgt(float left, float right) { return __aeabi_fcmplt(right, left); }

int __aeabi_fcmpge(float left, float right) { return __aeabi_fcmple(right, left); }

int __aeabi_fcmpun(float left, float right) { return !pair(left, right).ordered; }

}  // extern "C"
