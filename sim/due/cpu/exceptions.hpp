// Which exceptions are pending, enabled and active, and which of them preempts (ARMv7-M B1.5).
#pragma once

#include <array>
#include <cstdint>

#include "cpu/insn.hpp"

namespace due_emulator {

class Exceptions {
 public:
  static constexpr int kThreadPriority = 256;

  void reset();

  // The processor runs until *deadline; a preempting exception sets it to 0.
  void watch(std::uint64_t* deadline) { deadline_ = deadline; }

  void pend(std::uint8_t number);
  void unpend(std::uint8_t number);
  bool pending(std::uint8_t number) const { return has(pending_, number); }
  bool active(std::uint8_t number) const { return has(active_, number); }
  bool enabled(std::uint8_t number) const { return has(enabled_, number); }
  std::uint64_t pending_mask() const { return pending_; }
  std::uint64_t active_mask() const { return active_; }
  std::uint64_t enabled_mask() const { return enabled_; }
  void set_enabled(std::uint8_t number, bool enabled);
  // SHCSR writes the active bits of system exceptions directly.
  void set_active(std::uint8_t number, bool active);

  // Interrupt requests are levels: a line that is still high when its handler returns pends again.
  void set_line(std::uint8_t irq, bool high);
  bool line(std::uint8_t irq) const { return ((lines_ >> irq) & 1U) != 0; }

  void activate(std::uint8_t number);
  void deactivate(std::uint8_t number);

  int priority(std::uint8_t number) const { return priority_[number]; }
  void set_priority(std::uint8_t number, std::uint8_t value);
  std::uint8_t prigroup() const { return prigroup_; }
  void set_prigroup(std::uint8_t value);

  bool primask() const { return primask_; }
  bool faultmask() const { return faultmask_; }
  std::uint8_t basepri() const { return basepri_; }
  void set_primask(bool value);
  void set_faultmask(bool value);
  void set_basepri(std::uint8_t value);

  // Priority at which the processor runs, masks included; lower is more urgent.
  int execution_priority() const { return masked(true); }
  // True when `number`, if raised now, would be taken at once.
  bool can_take(std::uint8_t number) const;
  // The exception to take next, or 0.
  std::uint8_t next() const { return next_; }
  // Something pends that ends WFI; PRIMASK does not count.
  bool wakes() const;
  // Set by any new pending exception when SEVONPEND asks for it.
  bool sev_on_pend = false;
  bool event = false;

 private:
  static bool has(std::uint64_t set, std::uint8_t number) { return ((set >> number) & 1U) != 0; }
  static std::uint64_t bit(std::uint8_t number) { return std::uint64_t{1} << number; }
  int group(int priority) const;
  int masked(bool with_primask) const;
  std::uint8_t most_urgent(int below) const;
  void find_active_priority();
  void refresh();

  std::uint64_t pending_ = 0;
  std::uint64_t active_ = 0;
  std::uint64_t enabled_ = 0;
  std::uint64_t lines_ = 0;
  std::array<std::int16_t, 64> priority_{};
  int active_priority_ = kThreadPriority;
  std::uint8_t prigroup_ = 0;
  std::uint8_t basepri_ = 0;
  bool primask_ = false;
  bool faultmask_ = false;
  std::uint8_t next_ = 0;
  std::uint64_t* deadline_ = nullptr;
};

}  // namespace due_emulator
