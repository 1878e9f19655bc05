// Sends hello to a board and reads its welcome; see sim_board.hpp.
#include "sim_board.hpp"

#include <algorithm>
#include <array>
#include <cstddef>

#include "link/frame_writer.hpp"
#include "link/parser.hpp"

namespace heli_sim {

namespace {

using heli::link::FrameWriter;
using heli::link::HelloMessage;
using heli::link::MessageId;
using heli::link::WelcomeMessage;

// How often hello is repeated: a board that is still starting receives nothing.
constexpr std::uint32_t kAgain_ms = 20;

}  // namespace

// Sends hello and runs the board, a millisecond at a time with encoders at rest, until its welcome.
std::optional<WelcomeMessage> greet(SimBoard& board, std::uint32_t max_ms) {
  HelloMessage hello;
  hello.request = 1;
  hello.link_hash = heli::link::kLinkHash;
  std::array<std::uint8_t, HelloMessage::kSize> payload{};
  hello.write(payload.data());

  FrameWriter writer;
  heli::link::Parser parser;
  constexpr std::int32_t kStill[heli::kAxisCount] = {};
  for (std::uint32_t ms = 0; ms < max_ms; ++ms) {
    if (ms % kAgain_ms == 0) {
      std::array<std::uint8_t, FrameWriter::wire_bytes(HelloMessage::kSize)> frame{};
      const std::size_t size = writer.write(static_cast<std::uint8_t>(MessageId::hello),
                                            payload.data(), payload.size(), frame.data());
      std::for_each_n(frame.begin(), size, [&](std::uint8_t byte) { board.uart_receive(byte); });
    }
    board.tick(kStill);
    board.rest(nullptr, 0);
    for (std::uint8_t byte = 0; board.uart_transmit(byte);) {
      if (!parser.put(byte)) continue;
      const heli::link::Frame& answer = parser.frame();
      if (answer.id == static_cast<std::uint8_t>(MessageId::welcome) &&
          answer.size == WelcomeMessage::kSize) {
        return WelcomeMessage::read(answer.payload);
      }
    }
  }
  return std::nullopt;
}

}  // namespace heli_sim
