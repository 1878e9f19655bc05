// CRC-32 (IEEE 802.3, reflected), the same as zlib's crc32.
#pragma once

#include <cstddef>
#include <cstdint>

namespace heli::link {

// `crc_before` continues a checksum: crc32(b, nb, crc32(a, na)) is that of a followed by b.
std::uint32_t crc32(const std::uint8_t* bytes, std::size_t count, std::uint32_t crc_before = 0);

}  // namespace heli::link
