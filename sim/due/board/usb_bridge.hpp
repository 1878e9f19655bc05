// The ATmega16U2 between UART0 and USB, as its firmware (Arduino-usbserial.c) works.
//
// Bytes for the host wait in a ring of 128 and leave when timer 0 overflows, every 4.096 ms, or
// when more than 96 wait; nobody checks the ring for overflow. Bytes for the board are taken from
// USB while the other ring has room. A rising DTR pulls the reset line for 50 of those rounds; any
// change of the control lines at 1200 baud erases the flash first.
#pragma once

#include <cstdint>
#include <deque>
#include <vector>

#include "bus/clock.hpp"
#include "bus/scheduler.hpp"
#include "chip/chip.hpp"

namespace due_emulator {

class UsbBridge final : public EventSink, public SerialPeer {
 public:
  static constexpr std::size_t kRing = 128;  // bytes
  static constexpr std::size_t kNearlyFull = 96;
  static constexpr BoardTime kRound = BoardTime{344064} * kOneCycle;  // 256 * 256 / 16 MHz
  static constexpr int kResetRounds = 50;
  static constexpr int kEraseRounds = 180;
  static constexpr int kEraseFrom = 60;

  explicit UsbBridge(Chip& chip);

  // -- what the host's driver does --
  void set_line_coding(std::uint32_t baud);
  void set_control_lines(bool dtr);
  void write(const std::uint8_t* bytes, std::size_t count);
  std::vector<std::uint8_t> read();
  // False: the host has stopped polling the endpoint.
  void set_host_reading(bool reading) { host_reading_ = reading; }

  std::uint64_t to_host_lost() const { return to_host_lost_; }
  std::size_t to_board_waiting() const { return driver_.size() + to_board_.size(); }

  void byte_from_uart(std::uint8_t byte, std::uint32_t bit_cycles, std::uint64_t now) override;
  void event(std::uint64_t now) override;
  void clock_changed() override { plan(); }

 private:
  void round();
  void flush();
  void fill_ring();
  void run_reset_timer();
  void plan();
  // One bit at the 16U2's own rate: 2 MHz / (UBRR + 1).
  BoardTime bit_time() const { return kOneUs * (divider_ + 1) / 2; }

  Chip& chip_;
  Scheduler::Id id_;
  std::uint32_t baud_ = 9600;
  std::uint32_t divider_ = 207;  // UBRR1
  bool dtr_ = false;
  bool erasing_ = false;
  bool resetting_ = false;
  int reset_timer_ = 0;
  bool host_reading_ = true;
  std::deque<std::uint8_t> driver_;    // bytes in the host's driver
  std::deque<std::uint8_t> to_board_;  // ring of the 16U2
  std::deque<std::uint8_t> to_host_;   // ring of the 16U2
  std::vector<std::uint8_t> host_;     // bytes for read()
  std::uint64_t to_host_lost_ = 0;
  BoardTime next_round_ = kRound;
  BoardTime byte_done_ = 0;  // when the byte on its way to the board is sampled; 0: line idle
  BoardTime line_free_ = 0;
  std::uint8_t byte_ = 0;
};

}  // namespace due_emulator
