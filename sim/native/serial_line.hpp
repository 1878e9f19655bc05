// The serial line of the Due's programming port: UART0 and the ATmega16U2 that carries it to USB.
//
// 250 kbaud, 8N1: one byte every 40 us each way. Towards the host the 16U2 collects bytes in a ring
// of 128 and hands them over every 4.096 ms (timer 0 at 16 MHz / 256, 8 bits) or as soon as 96
// wait. The 16U2 does not check that ring for overflow, so a host that does not read loses bytes
// unnoticed. Towards the board the 16U2 takes bytes from USB only while its ring has room, so
// nothing is lost there: they wait in the host's driver.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "byte_ring.hpp"
#include "sim_board.hpp"

namespace heli_sim {

struct LineCounters {
  std::uint64_t to_board_bytes = 0;     // delivered to the board
  std::uint64_t to_host_bytes = 0;      // delivered to the host
  std::uint64_t to_host_overflow = 0;   // lost because the host did not read
  std::uint64_t to_board_overflow = 0;  // lost because the host's driver queue was full
};

class SerialLine {
 public:
  static constexpr std::uint32_t kByte_us = 10U * 1000000U / heli::link::kBaud;
  static constexpr std::uint32_t kBytesPerTick = heli::link::kTick_us / kByte_us;
  static constexpr std::uint64_t kBurst_us = 4096;
  static constexpr std::size_t kRingBytes = 128;
  static constexpr std::size_t kNearlyFull = 96;
  // Far more than a host that waits for answers can have in transit.
  static constexpr std::size_t kDriverBytes = 65536;

  void host_write(const std::uint8_t* bytes, std::size_t count);

  // Carry one millisecond, once each; what reaches the host is appended to `to_host`.
  void carry_to_board(SimBoard& board);
  void carry_to_host(SimBoard& board, std::vector<std::uint8_t>& to_host);

  // False: the host has the port closed or does not read; the ring towards it fills.
  void set_host_reading(bool reading) { host_reading_ = reading; }
  bool host_reading() const { return host_reading_; }

  // Empties every buffer, as pulling the USB plug does.
  void clear();

  const LineCounters& counters() const { return counters_; }
  std::size_t to_board_waiting() const {
    return driver_queue_.size() - driver_queue_start_ + to_board_.size();
  }

 private:
  void deliver_burst(std::vector<std::uint8_t>& to_host);

  std::vector<std::uint8_t> driver_queue_;
  std::size_t driver_queue_start_ = 0;
  ByteRing<kRingBytes> to_board_;
  ByteRing<kRingBytes> to_host_;
  LineCounters counters_;
  std::uint64_t now_us_ = 0;
  std::uint64_t next_burst_us_ = kBurst_us;
  bool host_reading_ = true;
};

}  // namespace heli_sim
