// CRC-32 of zlib and Ethernet, one byte per step by a table of its remainders.
#include "link/crc32.hpp"

#include <array>

namespace heli::link {
namespace {

constexpr std::array<std::uint32_t, 256> make_table() {
  std::array<std::uint32_t, 256> table{};
  for (std::uint32_t byte = 0; byte < 256; ++byte) {
    std::uint32_t remainder = byte;
    for (int bit = 0; bit < 8; ++bit) {
      // 0xedb88320: the polynomial, lowest bit first.
      remainder = (remainder >> 1U) ^ ((remainder & 1U) != 0 ? 0xedb88320U : 0U);
    }
    table[byte] = remainder;
  }
  return table;
}

// The table takes 1 KiB of flash; a byte then takes five instructions.
constexpr std::array<std::uint32_t, 256> kTable = make_table();
static_assert(kTable[1] == 0x77073096U && kTable[255] == 0x2d02ef8dU, "the table of zlib");

}  // namespace

std::uint32_t crc32(const std::uint8_t* bytes, std::size_t count, std::uint32_t crc_before) {
  std::uint32_t crc = ~crc_before;
  for (std::size_t i = 0; i < count; ++i) {
    crc = (crc >> 8U) ^ kTable[(crc ^ bytes[i]) & 0xffU];
  }
  return ~crc;
}

}  // namespace heli::link
