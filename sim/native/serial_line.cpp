// Carries bytes in steps of one millisecond; the times are those of serial_line.hpp.
#include "serial_line.hpp"

namespace heli_sim {

// Queues the host's bytes in its driver; those without room are lost.
void SerialLine::host_write(const std::uint8_t* bytes, std::size_t count) {
  const std::size_t queued = driver_queue_.size() - driver_queue_start_;
  const std::size_t room = kDriverBytes - queued;
  const std::size_t accepted = count < room ? count : room;
  counters_.to_board_overflow += count - accepted;
  if (queued == 0) {
    driver_queue_.clear();
    driver_queue_start_ = 0;
  }
  driver_queue_.insert(driver_queue_.end(), bytes, bytes + accepted);
}

// Bytes go from the driver into the 16U2's ring while it has room, and from there to the board at
// the line's rate, 25 in a millisecond.
void SerialLine::carry_to_board(SimBoard& board) {
  for (std::uint32_t byte_slot = 0; byte_slot < kBytesPerTick; ++byte_slot) {
    while (driver_queue_start_ < driver_queue_.size() &&
           to_board_.push(driver_queue_[driver_queue_start_])) {
      ++driver_queue_start_;
    }
    if (to_board_.empty()) return;
    board.uart_receive(to_board_.pop());
    ++counters_.to_board_bytes;
  }
}

// Bytes of the board enter the 16U2's ring one every 40 us. The ring is handed over at the end of
// each interval, and when it is nearly full.
void SerialLine::carry_to_host(SimBoard& board, std::vector<std::uint8_t>& to_host) {
  const std::uint64_t end_us = now_us_ + heli::link::kTick_us;
  std::uint8_t byte = 0;
  while (now_us_ < end_us && board.uart_transmit(byte)) {
    now_us_ += kByte_us;
    while (next_burst_us_ < now_us_) deliver_burst(to_host);
    if (to_host_.push(byte)) {
      if (to_host_.size() >= kNearlyFull && host_reading_) {
        counters_.to_host_bytes += to_host_.size();
        while (!to_host_.empty()) to_host.push_back(to_host_.pop());
      }
    } else {
      ++counters_.to_host_overflow;
    }
  }
  now_us_ = end_us;
  while (next_burst_us_ <= now_us_) deliver_burst(to_host);
}

// The end of the 16U2's interval: what its ring holds goes to the host, if that reads.
void SerialLine::deliver_burst(std::vector<std::uint8_t>& to_host) {
  next_burst_us_ += kBurst_us;
  if (!host_reading_) return;
  counters_.to_host_bytes += to_host_.size();
  while (!to_host_.empty()) to_host.push_back(to_host_.pop());
}

void SerialLine::clear() {
  driver_queue_.clear();
  driver_queue_start_ = 0;
  to_board_.clear();
  to_host_.clear();
}

}  // namespace heli_sim
