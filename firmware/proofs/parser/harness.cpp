// Any byte, from any state of the parser.
#include "any.hpp"
#include "link/parser.cpp"
#include "parser/invariant.hpp"

using heli::link::Parser;
using heli::proofs::any;

namespace heli::link {

// Contract: reads exactly the bytes that it is given, and returns any number.
std::uint32_t crc32(const std::uint8_t* bytes, std::size_t count, std::uint32_t) {
  if (count > 0U) {
    const volatile std::uint8_t first = bytes[0];
    const volatile std::uint8_t last = bytes[count - 1U];
    (void)first;
    (void)last;
  }
  return any<std::uint32_t>();
}

}  // namespace heli::link

// One byte from the line.
void step_put() {
  CONSTANT(Parser::kMaxBytes);
  Parser p = any<Parser>();
  ASSUME(heli::proofs::holds(p));
  const std::uint32_t ok = p.frames_ok_;
  const std::uint32_t lost = p.frames_lost_;
  const std::uint8_t last_sequence = p.last_sequence_;
  const bool in_sequence = p.in_sequence_;
  const auto byte = any<std::uint8_t>();

  const bool whole = p.put(byte);

  CLAIM(heli::proofs::holds(p), "the invariant is kept");
  CLAIM(byte != 0U || p.decoded_count_ == 0U, "a zero byte starts again");
  CLAIM(!whole || byte == 0U, "only a zero byte ends a frame");
  CLAIM(p.frames_ok_ == ok + (whole ? 1U : 0U), "each valid frame counts once");
  if (!whole) {
    CLAIM(p.frames_lost_ == lost && p.last_sequence_ == last_sequence,
          "an invalid frame has no sequence number");
    return;
  }
  const heli::link::Frame& frame = p.frame();
  CLAIM(frame.size <= heli::link::kMaxCommandPayload, "the payload fits");
  CLAIM(frame.payload == p.decoded_ + heli::link::kFrameHead, "the payload is in the buffer");
  CLAIM(p.decoded_[0] == heli::link::kProtocol, "the protocol is ours");
  const bool starts =
      !in_sequence || frame.id == static_cast<std::uint8_t>(heli::link::MessageId::hello);
  const auto step = static_cast<std::uint8_t>(frame.sequence - last_sequence);
  CLAIM(p.last_sequence_ == frame.sequence && p.in_sequence_, "its sequence number is the last");
  CLAIM(p.frames_lost_ == lost + (starts || step == 0U ? 0U : step - 1U), "gaps are counted");
}

// One byte of a COBS block.
void step_cobs() {
  auto decoder = any<heli::link::CobsDecoder>();
  const std::uint8_t left = decoder.left_;
  const auto byte = any<std::uint8_t>();
  ASSUME(byte != 0U);
  std::uint8_t decoded = 1;

  const bool gives = decoder.put(byte, decoded);

  CLAIM(left == 0U || (gives && decoded == byte), "inside a block each byte is itself");
  CLAIM(left == 0U || decoder.left_ == left - 1U, "a block ends");
  CLAIM(left != 0U || !gives || decoded == 0U, "between blocks there is a zero");
  CLAIM(left != 0U || decoder.left_ == byte - 1U, "a block is as long as its code says");
}

// A new parser.
void step_start() {
  CONSTANT(Parser::kMaxBytes);
  const Parser parser;
  CLAIM(heli::proofs::holds(parser), "the invariant holds at the start");
}
