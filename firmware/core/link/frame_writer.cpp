// Frame: protocol, id, sequence, payload, CRC-32, encoded with COBS.
#include "link/frame_writer.hpp"

#include "link/bytes.hpp"
#include "link/crc32.hpp"

namespace heli::link {

std::size_t FrameWriter::write(std::uint8_t id, const std::uint8_t* payload, std::size_t size,
                               std::uint8_t* to) {
  const std::uint8_t head[kFrameHead] = {kProtocol, id, sequence_++};
  std::uint8_t tail[kFrameTail];
  put_u32(tail, crc32(payload, size, crc32(head, kFrameHead)));

  CobsEncoder cobs(to);
  for (const std::uint8_t byte : head) cobs.put(byte);
  for (std::size_t i = 0; i < size; ++i) cobs.put(payload[i]);
  for (const std::uint8_t byte : tail) cobs.put(byte);
  return cobs.finish();
}

}  // namespace heli::link
