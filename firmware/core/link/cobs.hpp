// Consistent overhead byte stuffing, one byte at a time: no second buffer on either side.
//
// A block is a code byte c and c - 1 bytes that are not zero; a zero follows it in the decoded
// data unless c is 255 or the block is the last.
#pragma once

#include <cstddef>
#include <cstdint>

namespace heli::link {

// Longest encoding of `count` bytes, without the delimiter.
constexpr std::size_t cobs_bytes(std::size_t count) { return count + 1 + count / 254; }

class CobsEncoder {
 public:
  // `to` must have room for cobs_bytes() of all bytes that follow, plus the delimiter.
  explicit CobsEncoder(std::uint8_t* to) : to_(to) {}

  void put(std::uint8_t byte) {
    // The shortest encoding closes a full block only when more bytes follow.
    if (end_ - code_ == 255) open_block();
    if (byte == 0) {
      open_block();
    } else {
      to_[end_++] = byte;
    }
  }

  // Writes the delimiter; returns the length with it.
  std::size_t finish() {
    to_[code_] = static_cast<std::uint8_t>(end_ - code_);
    to_[end_++] = 0;
    return end_;
  }

 private:
  // Writes the code of the present block, and leaves room for the next one's.
  void open_block() {
    to_[code_] = static_cast<std::uint8_t>(end_ - code_);
    code_ = end_++;
  }

  std::uint8_t* to_;
  std::size_t code_ = 0;  // index of the present block's code byte
  std::size_t end_ = 1;   // index of the next byte
};

class CobsDecoder {
 public:
  // Takes one byte that is not the delimiter. True when it gives a decoded byte.
  bool put(std::uint8_t byte, std::uint8_t& decoded) {
    if (left_ == 0) {
      const bool zero_before = zero_follows_;
      left_ = static_cast<std::uint8_t>(byte - 1);
      zero_follows_ = byte != 255;
      decoded = 0;
      return zero_before;
    }
    --left_;
    decoded = byte;
    return true;
  }

  // At the delimiter: whether the last block was whole.
  bool whole() const { return left_ == 0; }

  void reset() {
    left_ = 0;
    zero_follows_ = false;
  }

 private:
  std::uint8_t left_ = 0;      // bytes that the block still needs
  bool zero_follows_ = false;  // a zero follows the block if another block does
};

}  // namespace heli::link
