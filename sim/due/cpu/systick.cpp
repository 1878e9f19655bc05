// SysTick (ARMv7-M B3.3): 24 bits downwards, by MCK or MCK/8, exception when 1 becomes 0.
#include "cpu/scs.hpp"
#include "cpu/scs_registers.hpp"

namespace due_emulator {

// SYST_CVR now. systick_zero_ is the cycle at which the counter becomes 0; from there it repeats.
std::uint32_t SystemControl::systick_value() const {
  if ((systick_control_ & scs::kSystEnable) == 0 || systick_reload_ == 0)
    return systick_stopped_value_;
  const std::uint64_t now = cpu_.cycles();
  if (now >= systick_zero_) {
    const std::uint64_t since = (now - systick_zero_) % systick_period();
    const std::uint64_t steps = since / systick_step();
    return steps == 0 ? 0U : static_cast<std::uint32_t>(systick_reload_ + 1 - steps);
  }
  const std::uint64_t steps = (systick_zero_ - now + systick_step() - 1) / systick_step();
  // One step before the reload value is loaded the counter still shows 0.
  return steps > systick_reload_ ? 0U : static_cast<std::uint32_t>(steps);
}

// Brings COUNTFLAG, the pending exception and systick_zero_ up to the present cycle, if the counter
// has reached 0 since the last call.
void SystemControl::catch_up_systick() {
  if ((systick_control_ & scs::kSystEnable) == 0 || systick_reload_ == 0) return;
  const std::uint64_t now = cpu_.cycles();
  if (now < systick_zero_) return;
  systick_control_ |= scs::kSystCountFlag;
  systick_zero_ += ((now - systick_zero_) / systick_period() + 1) * systick_period();
  if ((systick_control_ & scs::kSystTickInt) != 0) exceptions_.pend(exc::kSysTick);
}

// Lets the counter run from its stopped value (ENABLE was written, or the counter was cleared).
void SystemControl::start_systick() {
  const std::uint64_t value = systick_stopped_value_;
  // From a value of 0 the first clock loads the reload value.
  const std::uint64_t steps = value != 0 ? value : std::uint64_t{systick_reload_} + 1;
  systick_zero_ = cpu_.cycles() + steps * systick_step();
  plan_systick();
}

// Schedules event() for the next zero, if SysTick is to raise its exception there.
void SystemControl::plan_systick() {
  const bool running = (systick_control_ & scs::kSystEnable) != 0 && systick_reload_ != 0;
  const bool wanted = running && (systick_control_ & scs::kSystTickInt) != 0;
  scheduler_.set(id_, wanted ? systick_zero_ : kNever);
}

void SystemControl::event(std::uint64_t) {
  catch_up_systick();
  plan_systick();
}

}  // namespace due_emulator
