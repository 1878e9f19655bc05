// The ATmega16U2 of the programming port, byte by byte; see usb_bridge.hpp.
#include "board/usb_bridge.hpp"

#include <algorithm>
#include <utility>

namespace due_emulator {

namespace {

// A receiver tolerates this difference of the bit rates; see kLargestMismatch in uart.cpp.
constexpr double kLargestMismatch = 0.045;
constexpr std::uint32_t kEraseBaud = 1200;

}  // namespace

UsbBridge::UsbBridge(Chip& chip) : chip_(chip), id_(chip.system.scheduler.add(this)) {
  chip_.uart.set_peer(this);
  plan();
}

// USB CDC SET_LINE_CODING: the divider of the 16U2's UART.
void UsbBridge::set_line_coding(std::uint32_t baud) {
  baud_ = baud;
  // SERIAL_2X_UBBRVAL of LUFA: rounds to the nearest divider of 2 MHz.
  divider_ = std::max((2000000U + baud / 2) / baud, 1U) - 1;
}

// USB CDC SET_CONTROL_LINE_STATE: any change at 1200 baud starts the erase sequence, otherwise a
// rising DTR starts a reset.
void UsbBridge::set_control_lines(bool dtr) {
  const bool rising = dtr && !dtr_;
  dtr_ = dtr;
  if (baud_ == kEraseBaud) {
    reset_timer_ = kEraseRounds;
  } else if (rising) {
    reset_timer_ = kResetRounds;
  }
}

// Bytes from the host wait in its driver until the ring has room.
void UsbBridge::write(const std::uint8_t* bytes, std::size_t count) {
  driver_.insert(driver_.end(), bytes, bytes + count);
  fill_ring();
  plan();
}

// The bytes that have reached the host since the last call.
std::vector<std::uint8_t> UsbBridge::read() { return std::exchange(host_, {}); }

// The chip has sent a byte. With another bit rate the 16U2 reads a wrong one; if its ring is full,
// the byte is lost.
void UsbBridge::byte_from_uart(std::uint8_t byte, std::uint32_t bit_cycles, std::uint64_t) {
  // Both bits in cycles at 84 MHz.
  const double own_bit = static_cast<double>(bit_time()) / kOneCycle;
  const double sender_bit =
      static_cast<double>(bit_cycles) * kFull_Hz / chip_.system.clock.mck_Hz();
  if (sender_bit < (1.0 - kLargestMismatch) * own_bit ||
      sender_bit > (1.0 + kLargestMismatch) * own_bit)
    byte = static_cast<std::uint8_t>(byte ^ 0xA5U);
  if (to_host_.size() >= kRing) {
    ++to_host_lost_;
    return;
  }
  to_host_.push_back(byte);
  if (to_host_.size() > kNearlyFull) round();
}

// Hands the ring to the host, if the host polls.
void UsbBridge::flush() {
  if (!host_reading_) return;
  host_.insert(host_.end(), to_host_.begin(), to_host_.end());
  to_host_.clear();
}

// What the 16U2's main loop does when the timer has run over or the ring is nearly full.
void UsbBridge::round() {
  flush();
  run_reset_timer();
}

// Counts the reset timer down, one per round: from kEraseFrom up the ERASE pin is high, and the
// flash is empty when it falls; in the last kResetRounds rounds the reset line is low.
void UsbBridge::run_reset_timer() {
  const bool erase = reset_timer_ >= kEraseFrom;
  if (erasing_ && !erase) {
    chip_.efc0.erase_all();
    chip_.efc1.erase_all();
    chip_.flash.gpnvm = 0;
  }
  erasing_ = erase;
  const bool reset = reset_timer_ >= 1 && reset_timer_ <= kResetRounds;
  if (reset != resetting_) chip_.set_nrst(reset);
  resetting_ = reset;
  if (reset_timer_ > 0) --reset_timer_;
}

// Fills the ring from the host's driver, and begins to send its next byte if the line is idle.
void UsbBridge::fill_ring() {
  while (!driver_.empty() && to_board_.size() < kRing) {
    to_board_.push_back(driver_.front());
    driver_.pop_front();
  }
  const BoardTime now = chip_.system.board_now();
  if (byte_done_ != 0 || to_board_.empty()) return;
  byte_ = to_board_.front();
  to_board_.pop_front();
  const BoardTime start = std::max(now, line_free_);
  // A byte has 10 bits; the receiver samples the stop bit in its middle, after 9.5.
  byte_done_ = start + bit_time() * 19 / 2;
  line_free_ = start + bit_time() * 10;
}

// Schedules event() for the byte on the line or the next round.
void UsbBridge::plan() {
  const BoardTime first = byte_done_ != 0 ? std::min(byte_done_, next_round_) : next_round_;
  chip_.system.scheduler.set(id_, chip_.system.clock.cycle_at(first));
}

// The byte on the line has arrived at the chip, or timer 0 has overflowed.
void UsbBridge::event(std::uint64_t) {
  const BoardTime now = chip_.system.board_now();
  if (byte_done_ != 0 && byte_done_ <= now) {
    byte_done_ = 0;
    const BoardTime cycle = BoardTime{kFull_Hz} * kOneCycle / chip_.system.clock.mck_Hz();
    chip_.uart.receive(byte_, bit_time() / cycle);
    fill_ring();
  }
  if (next_round_ <= now) {
    next_round_ += kRound;
    round();
  }
  plan();
}

}  // namespace due_emulator
