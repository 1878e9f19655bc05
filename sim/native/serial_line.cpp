#include "serial_line.hpp"

namespace heli_sim {

void SerialLine::host_write(const std::uint8_t* bytes, std::size_t count) {
  const std::size_t waiting = driver_.size() - driver_first_;
  const std::size_t room = kDriverBytes - waiting;
  const std::size_t taken = count < room ? count : room;
  counters_.to_board_overflow += count - taken;
  if (waiting == 0) {
    driver_.clear();
    driver_first_ = 0;
  }
  driver_.insert(driver_.end(), bytes, bytes + taken);
}

void SerialLine::carry_to_board(SimBoard& board) {
  for (std::uint32_t slot = 0; slot < kBytesPerTick; ++slot) {
    while (driver_first_ < driver_.size() && to_board_.push(driver_[driver_first_])) {
      ++driver_first_;
    }
    if (to_board_.empty()) return;
    board.uart_receive(to_board_.pop());
    ++counters_.to_board_bytes;
  }
}

void SerialLine::carry_to_host(SimBoard& board, std::vector<std::uint8_t>& to_host) {
  const std::uint64_t end_us = now_us_ + heli::link::kTick_us;
  std::uint8_t byte = 0;
  while (now_us_ < end_us && board.uart_transmit(byte)) {
    now_us_ += kByte_us;
    while (next_burst_us_ < now_us_) hand_over(to_host);
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
  while (next_burst_us_ <= now_us_) hand_over(to_host);
}

void SerialLine::hand_over(std::vector<std::uint8_t>& to_host) {
  next_burst_us_ += kBurst_us;
  if (!host_reading_) return;
  counters_.to_host_bytes += to_host_.size();
  while (!to_host_.empty()) to_host.push_back(to_host_.pop());
}

void SerialLine::clear() {
  driver_.clear();
  driver_first_ = 0;
  to_board_.clear();
  to_host_.clear();
}

}  // namespace heli_sim
