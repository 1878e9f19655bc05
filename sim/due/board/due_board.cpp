#include "board/due_board.hpp"

#include <algorithm>

namespace heli_due {

namespace {

// One bit of the line between the 16U2 and the chip.
constexpr BoardTime kBit = BoardTime{1000000} * kOneUs / heli::link::kBaud;

}  // namespace

DueBoard::DueBoard() : due_(std::make_unique<Due>()), id_(due_->chip.system.scheduler.add(this)) {
  due_->chip.uart.set_peer(this);
}

void DueBoard::run(const heli_sim::EncoderInput& encoders) {
  if (!due_->chip.powered()) due_->power_on();
  const BoardTime start = tick_end_;
  tick_end_ = start + kOneMs;
  for (int axis = 0; axis < kEncoders; ++axis) {
    if (due_->encoder(axis) != encoders.count[axis]) due_->set_encoder(axis, encoders.count[axis]);
  }
  for (std::size_t i = 0; i < encoders.edge_count; ++i) {
    const heli_sim::Edge& edge = encoders.edges[i];
    const double share = edge.time_us / 1000.0 * static_cast<double>(phase_);
    const auto offset = static_cast<BoardTime>(share);
    due_->schedule_step(edge.axis, edge.direction, start + offset);
  }
  due_->run_until(tick_end_);
  if (aligned_to_ != 0) shift_phase(start);
  if (due_->chip.system.cpu.halt() == Halt::kLockup) throw Stop("the processor is locked up");
}

void DueBoard::align(std::uint8_t number, double phase_us) {
  aligned_to_ = number;
  aligned_ = false;
  phase_ = static_cast<BoardTime>(phase_us * static_cast<double>(kOneUs));
}

void DueBoard::shift_phase(BoardTime start) {
  const Chip& chip = due_->chip;
  if (chip.resets() != resets_seen_) {
    resets_seen_ = chip.resets();
    aligned_ = false;
  }
  const BoardTime entry = chip.system.clock.time_at(chip.system.cpu.stats(aligned_to_).last_entry);
  if (aligned_ || entry <= start || entry > tick_end_) return;
  // The handler was `entry - start` into this millisecond; from the next one on it is at phase_.
  const BoardTime shift = (entry - start + kOneMs - phase_) % kOneMs;
  tick_end_ += shift;
  due_->run_until(tick_end_);
  aligned_ = true;
}

heli_sim::MotorOutput DueBoard::motors() const {
  const bool front = due_->motor_enabled(0);
  const bool back = due_->motor_enabled(1);
  return {front ? due_->motor_duty(0) : 0.0, back ? due_->motor_duty(1) : 0.0, front || back};
}

void DueBoard::reset(heli::link::Reset cause) {
  to_uart_.clear();
  from_uart_.clear();
  byte_due_ = 0;
  if (cause == heli::link::Reset::power_up) {
    due_->power_off();
    due_->power_on();
    return;
  }
  due_->chip.set_nrst(true);
  reset_end_ = due_->now() + kResetTime;
  plan();
}

void DueBoard::uart_receive(std::uint8_t byte) {
  to_uart_.push_back(byte);
  plan();
}

bool DueBoard::uart_transmit(std::uint8_t& byte) {
  if (from_uart_.empty()) return false;
  byte = from_uart_.front();
  from_uart_.pop_front();
  return true;
}

void DueBoard::byte_from_uart(std::uint8_t byte, std::uint32_t, std::uint64_t) {
  from_uart_.push_back(byte);
}

void DueBoard::plan() {
  const BoardTime now = due_->now();
  if (byte_due_ == 0 && !to_uart_.empty()) {
    const BoardTime start = std::max(now, wire_free_);
    byte_due_ = start + kBit * 19 / 2;  // the middle of the stop bit
    wire_free_ = start + kBit * 10;
  }
  BoardTime first = ~BoardTime{0};
  if (byte_due_ != 0) first = std::min(first, byte_due_);
  if (reset_end_ != 0) first = std::min(first, reset_end_);
  const bool any = first != ~BoardTime{0};
  due_->chip.system.scheduler.set(id_, any ? due_->chip.system.clock.cycle_at(first) : kNever);
}

void DueBoard::event(std::uint64_t) {
  const BoardTime now = due_->now();
  if (byte_due_ != 0 && byte_due_ <= now) {
    byte_due_ = 0;
    const BoardTime cycle = BoardTime{kFull_Hz} * kOneCycle / due_->chip.system.clock.mck_Hz();
    due_->chip.uart.receive(to_uart_.front(), kBit / cycle);
    to_uart_.pop_front();
  }
  if (reset_end_ != 0 && reset_end_ <= now) {
    reset_end_ = 0;
    due_->chip.set_nrst(false);
  }
  plan();
}

}  // namespace heli_due
