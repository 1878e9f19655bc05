// Runs the emulated Due a millisecond at a time, in step with its control tick; see due_board.hpp.
#include "due_board.hpp"

#include <algorithm>
#include <cstdlib>
#include <vector>

namespace heli_sim {

namespace {

using due_emulator::Due;
using due_emulator::Exceptions;
using due_emulator::Halt;
using due_emulator::kFull_Hz;
using due_emulator::kNever;
using due_emulator::kOneCycle;
using due_emulator::kOneMs;
using due_emulator::kOneUs;
using due_emulator::Stop;

// Board time of one bit between the 16U2 and the chip, and of a byte with its start and stop bits.
constexpr BoardTime kBit = BoardTime{1000000} * kOneUs / heli::link::kBaud;
constexpr BoardTime kByte = 10 * kBit;

// Time from the begin of the next tick to the last byte of a millisecond. While the tick runs, the
// idle loop does not, so it receives whole frames once per tick, as on the native board.
constexpr BoardTime kLastByte = 15 * kOneUs;
// Time from the last edge to the next tick, so that filters and interrupts have finished by then.
constexpr BoardTime kSettleTime = 5 * kOneUs;
// When to check for the first time whether the handler has returned, and how often after that.
constexpr BoardTime kFirstPoll = 100 * kOneUs;
constexpr BoardTime kPollInterval = 25 * kOneUs;
constexpr BoardTime kPwmPeriod = 50 * kOneUs;
// A program has this many PWM periods, 0.1 s, to begin its first tick.
constexpr int kMaxBootPeriods = 2000;
// A test may move the arm to another place. Its steps are then played at 150 per tick at most.
constexpr std::int32_t kMaxStepsPerTick = 150;

}  // namespace

// Makes the board the peer of the chip's UART, in place of the USB bridge.
DueBoard::DueBoard() : due_(std::make_unique<Due>()), id_(due_->chip.system.scheduler.add(this)) {
  wire(*due_);
  due_->chip.uart.set_peer(this);
}

void DueBoard::align(std::uint8_t handler) {
  handler_ = handler;
  aligned_ = false;
}

// Runs the board, but not backwards; throws Stop if the processor is locked up.
void DueBoard::run_until(BoardTime until) {
  if (until > due_->now()) due_->run_until(until);
  if (due_->chip.system.cpu.halt() == Halt::kLockup) throw Stop("the processor is locked up");
}

// Whether the tick's handler has begun since the last call. The first time, the millisecond is
// aligned to its beginning.
bool DueBoard::ticked() {
  const std::uint64_t entry = due_->chip.system.cpu.stats(handler_).last_entry;
  if (handler_ == 0 || entry == last_entry_) return false;
  last_entry_ = entry;
  if (aligned_) return true;
  tick_at_ = due_->chip.system.clock.time_at(entry);
  aligned_ = true;
  return true;
}

// Switches the power on and runs to the program's first tick, or for kMaxBootPeriods.
void DueBoard::start() {
  due_->power_on();
  tick_at_ = due_->now();
  if (handler_ == 0 || in_reset()) return;
  for (int period = 0; period < kMaxBootPeriods && !ticked(); ++period)
    run_until(due_->now() + kPwmPeriod);
  if (!aligned_) tick_at_ = due_->now();
}

// Runs until the tick's handler has returned and its duties are at the pins, a PWM period later.
void DueBoard::wait_for_command() {
  run_until(tick_at_ + kFirstPoll);
  if (!ticked()) {
    // In reset, starting, or hung: align again to the next handler that begins.
    aligned_ = false;
    return;
  }
  const Exceptions& exceptions = due_->chip.system.exceptions;
  const BoardTime latest = tick_at_ + kOneMs - kPwmPeriod - kSettleTime;
  while (exceptions.active(handler_) && due_->now() < latest)
    run_until(due_->now() + kPollInterval);
  run_until(due_->now() + kPwmPeriod);
}

// The first part of a millisecond, up to the motor command; see sim_board.hpp. Also notes how many
// bytes of the program may leave in this millisecond, and plans those that arrive.
void DueBoard::tick(const std::int32_t* count) {
  for (int axis = 0; axis < kEncoders; ++axis) {
    // Without power, the board's encoders follow the rig without edges.
    if (!due_->chip.powered()) due_->set_encoder(axis, count[axis]);
    unreported_steps_[static_cast<std::size_t>(axis)] = count[axis] - due_->encoder(axis);
  }
  sendable_bytes_ = from_uart_.size() + due_->chip.uart.unsent();
  const bool earliest = !due_->chip.powered();
  if (earliest) start();
  plan_bytes();
  if (handler_ == 0) return;
  if (earliest) last_entry_ = 0;
  wait_for_command();
}

// The rest of the millisecond, with the encoders' edges spread over it.
void DueBoard::rest(const Edge* edges, std::size_t edge_count) {
  const BoardTime from = due_->now();
  const BoardTime end = tick_at_ + kOneMs;
  const BoardTime until = std::max(from, end - kSettleTime);
  // Times of edges are in us of a whole millisecond; here they spread over what is left of it.
  const double per_us = static_cast<double>(until - from) / 1000.0;
  std::vector<Edge> steps(edges, edges + edge_count);
  for (std::uint8_t axis = 0; axis < kEncoders; ++axis) {
    // The rig was moved without edges: catches up, evenly over the millisecond.
    const std::int32_t pending_steps =
        std::clamp(unreported_steps_[axis], -kMaxStepsPerTick, kMaxStepsPerTick);
    for (std::int32_t k = 0; k < std::abs(pending_steps); ++k) {
      const double time_us = 1000.0 * (k + 0.5) / std::abs(pending_steps);
      steps.push_back({time_us, axis, static_cast<std::int8_t>(pending_steps > 0 ? 1 : -1)});
    }
  }
  std::stable_sort(steps.begin(), steps.end(),
                   [](const auto& a, const auto& b) { return a.time_us < b.time_us; });
  for (const Edge& step : steps) {
    due_->schedule_step(step.axis, step.direction,
                        from + static_cast<BoardTime>(step.time_us * per_us));
  }
  run_until(until);
  if (handler_ == 0) run_until(end);
  tick_at_ = end;
  // A program that began in this millisecond: its first tick aligned tick_at_ to its beginning.
  if (handler_ != 0 && !aligned_ && ticked()) tick_at_ += kOneMs;
}

// The duties at the pins; a motor with its bridge off has none.
MotorOutput DueBoard::motors() const {
  const bool front = motor_enabled(*due_, 0);
  const bool back = motor_enabled(*due_, 1);
  return {front ? motor_duty(*due_, 0) : 0.0, back ? motor_duty(*due_, 1) : 0.0, front || back};
}

// All bytes under way are lost; see due_board.hpp.
void DueBoard::reset(heli::link::Reset cause) {
  to_uart_.clear();
  from_uart_.clear();
  sendable_bytes_ = 0;
  aligned_ = false;
  if (cause == heli::link::Reset::power_up) {
    due_->power_off();
    due_->power_on();
    return;
  }
  due_->chip.set_nrst(true);
  reset_end_ = due_->now() + kResetTime;
  plan();
}

// Empties both flash planes under reset, and makes the chip boot from its ROM.
void DueBoard::erase() {
  reset(heli::link::Reset::user);
  // The processor must be in reset before its program goes.
  run_until(due_->now() + kOneUs);
  due_->chip.efc0.erase_all();
  due_->chip.efc1.erase_all();
  due_->chip.flash.gpnvm = 0;
}

// The next byte that left the chip before this millisecond.
bool DueBoard::uart_transmit(std::uint8_t& byte) {
  if (sendable_bytes_ == 0 || from_uart_.empty()) return false;
  --sendable_bytes_;
  byte = from_uart_.front();
  from_uart_.pop_front();
  return true;
}

void DueBoard::byte_from_uart(std::uint8_t byte, std::uint32_t, std::uint64_t) {
  from_uart_.push_back(byte);
}

// Gives the bytes that came since the last tick their times of arrival: without gaps, and the last
// one at kLastByte after the next tick.
void DueBoard::plan_bytes() {
  const auto is_new = [](const Arrival& arrival) { return arrival.when == 0; };
  const auto count =
      static_cast<BoardTime>(std::count_if(to_uart_.begin(), to_uart_.end(), is_new));
  const BoardTime last = tick_at_ + kOneMs + kLastByte;
  BoardTime when = std::max({due_->now(), wire_free_time_, last + kByte - count * kByte});
  for (Arrival& arrival : to_uart_) {
    if (!is_new(arrival)) continue;
    arrival.when = when;
    when += kByte;
    wire_free_time_ = when;
  }
  plan();
}

// Schedules the next arriving byte or the end of the reset, whichever comes first.
void DueBoard::plan() {
  BoardTime earliest = ~BoardTime{0};
  if (!to_uart_.empty() && to_uart_.front().when != 0) earliest = to_uart_.front().when;
  if (reset_end_ != 0) earliest = std::min(earliest, reset_end_);
  const bool has_event = earliest != ~BoardTime{0};
  due_->chip.system.scheduler.set(id_,
                                  has_event ? due_->chip.system.clock.cycle_at(earliest) : kNever);
}

// Delivers the byte whose time has come, and ends a reset.
void DueBoard::event(std::uint64_t) {
  const BoardTime now = due_->now();
  if (!to_uart_.empty() && to_uart_.front().when != 0 && to_uart_.front().when <= now) {
    const BoardTime cycle = BoardTime{kFull_Hz} * kOneCycle / due_->chip.system.clock.mck_Hz();
    due_->chip.uart.receive(to_uart_.front().byte, kBit / cycle);
    to_uart_.pop_front();
  }
  if (reset_end_ != 0 && reset_end_ <= now) {
    reset_end_ = 0;
    due_->chip.set_nrst(false);
  }
  plan();
}

}  // namespace heli_sim
