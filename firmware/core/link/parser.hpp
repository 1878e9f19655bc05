// Turns received bytes into frames. After any wrong bytes, the next zero byte starts a new frame.
#pragma once

#include <cstddef>
#include <cstdint>

#include "link/cobs.hpp"
#include "link/declaration.hpp"

namespace heli::link {

// protocol | id | sequence | payload | crc
inline constexpr std::size_t kFrameHead = 3;
inline constexpr std::size_t kFrameTail = 4;

struct Frame {
  std::uint8_t id = 0;
  std::uint8_t sequence = 0;
  std::uint8_t size = 0;
  const std::uint8_t* payload = nullptr;  // valid until the next byte is put
};

class Parser {
 public:
  // True when `byte` completed a valid frame, which is then in frame().
  bool put(std::uint8_t byte);
  const Frame& frame() const { return frame_; }

  std::uint32_t frames_ok() const { return frames_ok_; }
  std::uint32_t frames_bad() const { return frames_bad_; }    // COBS, length, CRC or protocol
  std::uint32_t frames_lost() const { return frames_lost_; }  // gaps in the sequence numbers
  std::uint32_t bytes_dropped() const {
    return bytes_dropped_;
  }  // in bad frames, without delimiters

 private:
  bool finish();
  void count_gap();

  static constexpr std::size_t kMaxBytes = kFrameHead + kMaxCommandPayload + kFrameTail;

  std::uint8_t decoded_[kMaxBytes] = {};
  std::size_t decoded_count_ = 0;
  std::uint32_t received_ = 0;  // bytes since the last delimiter
  bool too_long_ = false;
  bool in_sequence_ = false;
  std::uint8_t last_sequence_ = 0;
  CobsDecoder cobs_;
  Frame frame_;
  std::uint32_t frames_ok_ = 0;
  std::uint32_t frames_bad_ = 0;
  std::uint32_t frames_lost_ = 0;
  std::uint32_t bytes_dropped_ = 0;
};

}  // namespace heli::link
