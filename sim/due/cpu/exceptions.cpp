// Pending, enabled and active exceptions, and which of them is the most urgent.
#include "cpu/exceptions.hpp"

#include <algorithm>

namespace due_emulator {

namespace {

// Always enabled: reset, NMI, HardFault, SVCall, DebugMonitor, PendSV, SysTick.
constexpr std::uint64_t kAlwaysEnabled = (1U << 1) | (1U << exc::kNmi) | (1U << exc::kHardFault) |
                                         (1U << exc::kSvCall) | (1U << exc::kDebugMonitor) |
                                         (1U << exc::kPendSv) | (1U << exc::kSysTick);
constexpr std::uint8_t kPriorityMask = 0xF0;  // 4 bits on this chip

}  // namespace

// Only reset, NMI and HardFault have fixed priorities, below 0.
void Exceptions::reset() {
  pending_ = 0;
  active_ = 0;
  enabled_ = kAlwaysEnabled;
  lines_ = 0;
  priority_.fill(0);
  priority_[1] = -3;
  priority_[exc::kNmi] = -2;
  priority_[exc::kHardFault] = -1;
  active_priority_ = kThreadPriority;
  prigroup_ = 0;
  basepri_ = 0;
  primask_ = false;
  faultmask_ = false;
  sev_on_pend = false;
  event = false;
  next_ = 0;
}

// The part of a priority that decides about preemption: AIRCR.PRIGROUP takes its lower bits away.
int Exceptions::group(int priority) const {
  if (priority < 0) return priority;
  return priority & ~((2 << prigroup_) - 1) & 0xFF;
}

// The priority of the running code (ExecutionPriority, B1.5.4): that of the most urgent active
// exception, raised by BASEPRI, PRIMASK and FAULTMASK.
int Exceptions::masked(bool with_primask) const {
  int priority = active_priority_;
  if (basepri_ != 0) priority = std::min(priority, group(basepri_));
  if (primask_ && with_primask) priority = std::min(priority, 0);
  if (faultmask_) priority = std::min(priority, -1);
  return priority;
}

// The pending and enabled exception with the lowest priority value, and of equals the lowest
// number; 0 if it would not preempt code that runs at priority `below`.
std::uint8_t Exceptions::most_urgent(int below) const {
  std::uint64_t candidates = pending_ & enabled_;
  std::uint8_t best = 0;
  int best_priority = kThreadPriority;
  while (candidates != 0) {
    const auto number = static_cast<std::uint8_t>(__builtin_ctzll(candidates));
    candidates &= candidates - 1;
    if (priority_[number] < best_priority) {
      best_priority = priority_[number];
      best = number;
    }
  }
  return best != 0 && group(best_priority) < below ? best : std::uint8_t{0};
}

// Finds the exception to take next, after a change of pending, enabled, priorities or masks, and
// ends the run of the processor (deadline) if there is one.
void Exceptions::refresh() {
  next_ = 0;
  if ((pending_ & enabled_) == 0) return;
  next_ = most_urgent(execution_priority());
  // A sleeping processor must wake, even if a mask holds the exception back.
  if (deadline_ != nullptr && (next_ != 0 || primask_)) *deadline_ = 0;
}

bool Exceptions::wakes() const { return most_urgent(masked(false)) != 0; }

bool Exceptions::can_take(std::uint8_t number) const {
  return enabled(number) && group(priority_[number]) < execution_priority();
}

// Recomputes the priority of the most urgent active exception.
void Exceptions::find_active_priority() {
  active_priority_ = kThreadPriority;
  for (std::uint64_t left = active_; left != 0; left &= left - 1) {
    const int priority = priority_[static_cast<std::size_t>(__builtin_ctzll(left))];
    active_priority_ = std::min(active_priority_, group(priority));
  }
}

// The exception waits for its turn. A new one is also an event for WFE, if SEVONPEND is set.
void Exceptions::pend(std::uint8_t number) {
  if (sev_on_pend && !pending(number)) event = true;
  pending_ |= bit(number);
  refresh();
}

// As by NVIC_ICPR or ICSR.
void Exceptions::unpend(std::uint8_t number) {
  pending_ &= ~bit(number);
  // ICPR cannot clear what a peripheral still asks for.
  if (number >= exc::kIrq0 && line(static_cast<std::uint8_t>(number - exc::kIrq0)) &&
      !active(number)) {
    pending_ |= bit(number);
  }
  refresh();
}

void Exceptions::set_enabled(std::uint8_t number, bool enabled) {
  enabled_ = enabled ? enabled_ | bit(number) : enabled_ & ~bit(number);
  refresh();
}

void Exceptions::set_active(std::uint8_t number, bool active) {
  active_ = active ? active_ | bit(number) : active_ & ~bit(number);
  find_active_priority();
  refresh();
}

// A peripheral's request line changes. A rising edge pends the interrupt immediately.
void Exceptions::set_line(std::uint8_t irq, bool high) {
  const std::uint64_t mask = std::uint64_t{1} << irq;
  const bool was = (lines_ & mask) != 0;
  if (high == was) return;
  lines_ = high ? lines_ | mask : lines_ & ~mask;
  if (high) pend(static_cast<std::uint8_t>(exc::kIrq0 + irq));
}

// The processor enters the handler of `number`.
void Exceptions::activate(std::uint8_t number) {
  pending_ &= ~bit(number);
  active_ |= bit(number);
  active_priority_ = std::min(active_priority_, group(priority_[number]));
  refresh();
}

// The processor returns from it.
void Exceptions::deactivate(std::uint8_t number) {
  active_ &= ~bit(number);
  if (number >= exc::kIrq0 && line(static_cast<std::uint8_t>(number - exc::kIrq0))) {
    pending_ |= bit(number);
  }
  find_active_priority();
  refresh();
}

// The chip has four bits of priority, the upper ones.
void Exceptions::set_priority(std::uint8_t number, std::uint8_t value) {
  priority_[number] = value & kPriorityMask;
  find_active_priority();
  refresh();
}

void Exceptions::set_prigroup(std::uint8_t value) {
  prigroup_ = value;
  find_active_priority();
  refresh();
}

void Exceptions::set_primask(bool value) {
  primask_ = value;
  refresh();
}

void Exceptions::set_faultmask(bool value) {
  faultmask_ = value;
  refresh();
}

void Exceptions::set_basepri(std::uint8_t value) {
  basepri_ = value & kPriorityMask;
  refresh();
}

}  // namespace due_emulator
