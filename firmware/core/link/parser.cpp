// Decodes, checks and counts frames, byte by byte; see parser.hpp. Idle loop.
#include "link/parser.hpp"

#include "link/bytes.hpp"
#include "link/crc32.hpp"

namespace heli::link {

bool Parser::put(std::uint8_t byte) {
  ++received_;
  if (byte != 0) {
    std::uint8_t decoded = 0;
    if (!too_long_ && cobs_.put(byte, decoded)) {
      if (decoded_count_ == kMaxBytes) {
        too_long_ = true;
      } else {
        decoded_[decoded_count_++] = decoded;
      }
    }
    return false;
  }
  // A lone delimiter is no error: a sender may flush the line with one.
  const bool empty = received_ == 1;
  const bool ok = !empty && finish();
  if (!ok && !empty) {
    ++frames_bad_;
    bytes_dropped_ += received_ - 1;
  }
  received_ = 0;
  decoded_count_ = 0;
  too_long_ = false;
  cobs_.reset();
  return ok;
}

// At a delimiter: true if the decoded bytes are a valid frame.
bool Parser::finish() {
  if (too_long_ || !cobs_.whole() || decoded_count_ < kFrameHead + kFrameTail) return false;
  const std::size_t checked = decoded_count_ - kFrameTail;
  if (crc32(decoded_, checked) != get_u32(decoded_ + checked)) return false;
  if (decoded_[0] != kProtocol) return false;
  frame_.id = decoded_[1];
  frame_.sequence = decoded_[2];
  frame_.size = static_cast<std::uint8_t>(checked - kFrameHead);
  frame_.payload = decoded_ + kFrameHead;
  ++frames_ok_;
  count_gap();
  return true;
}

// Counts the frames that are missing before this one, by their sequence numbers.
void Parser::count_gap() {
  const auto step = static_cast<std::uint8_t>(frame_.sequence - last_sequence_);
  // Step 0 is the same frame once more. A hello may come from a host that has just started to
  // count.
  const bool is_first = !in_sequence_ || frame_.id == static_cast<std::uint8_t>(MessageId::hello);
  if (!is_first && step > 1) frames_lost_ += static_cast<std::uint32_t>(step - 1);
  last_sequence_ = frame_.sequence;
  in_sequence_ = true;
}

}  // namespace heli::link
