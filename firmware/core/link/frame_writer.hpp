// Payload in, bytes for the wire out; counts the frames of its direction.
#pragma once

#include <cstddef>
#include <cstdint>

#include "link/cobs.hpp"
#include "link/declaration.hpp"
#include "link/parser.hpp"

namespace heli::link {

class FrameWriter {
 public:
  // Room that write() may need for a payload of this size.
  static constexpr std::size_t wire_bytes(std::size_t payload) {
    return cobs_bytes(kFrameHead + payload + kFrameTail) + 1;
  }

  // Returns the length of the frame, its delimiter included.
  std::size_t write(std::uint8_t id, const std::uint8_t* payload, std::size_t size,
                    std::uint8_t* to);

 private:
  std::uint8_t sequence_ = 0;
};

}  // namespace heli::link
