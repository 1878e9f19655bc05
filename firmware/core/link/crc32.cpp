#include "link/crc32.hpp"

#include <array>

namespace heli::link {
namespace {

constexpr std::array<std::uint32_t, 256> make_table() {
  std::array<std::uint32_t, 256> table{};
  for (std::uint32_t byte = 0; byte < 256; ++byte) {
    std::uint32_t rest = byte;
    for (int bit = 0; bit < 8; ++bit) {
      rest = (rest >> 1U) ^ ((rest & 1U) != 0 ? 0xedb88320U : 0U);
    }
    table[byte] = rest;
  }
  return table;
}

// 1 KiB of flash for five instructions a byte.
constexpr std::array<std::uint32_t, 256> kTable = make_table();
static_assert(kTable[1] == 0x77073096U && kTable[255] == 0x2d02ef8dU, "the table of zlib");

}  // namespace

std::uint32_t crc32(const std::uint8_t* bytes, std::size_t count, std::uint32_t before) {
  std::uint32_t crc = ~before;
  for (std::size_t i = 0; i < count; ++i) {
    crc = (crc >> 8U) ^ kTable[(crc ^ bytes[i]) & 0xffU];
  }
  return ~crc;
}

}  // namespace heli::link
