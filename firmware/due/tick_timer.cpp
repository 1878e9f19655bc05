#include "tick_timer.hpp"

#include "clock.hpp"
#include "cortex_m3.hpp"
#include "link/declaration.hpp"
#include "priorities.hpp"
#include "registers.hpp"

namespace heli::due::tick_timer {
namespace {

// TIMER_CLOCK1 is half the master clock.
constexpr std::uint32_t kCountsPer_us = clock::kMck_Hz / 2 / 1000000;
constexpr std::uint32_t kPeriod = link::kTick_us * kCountsPer_us;

// Channel 0 of the block TC1: none of its pins is brought out on the Due.
TcChannel& channel() { return TC1->TC_CHANNEL[0]; }
constexpr unsigned kInterrupt = ID_TC3;

}  // namespace

void start() {
  PMC->PMC_PCER0.write(bit(ID_TC3));
  channel().TC_CMR.write(TC_CMR_TCCLKS_TIMER_CLOCK1 | TC_CMR_WAVE | TC_CMR_WAVSEL_UP_RC);
  channel().TC_RC.write(kPeriod);
  channel().TC_IER.write(TC_IER_CPCS);
  enable_interrupt(kInterrupt, kTickPriority);
  channel().TC_CCR.write(TC_CCR_CLKEN | TC_CCR_SWTRG);
}

void acknowledge() { static_cast<void>(channel().TC_SR.read()); }

TickTiming timing() {
  const bool late = interrupt_pending(kInterrupt);
  const std::uint32_t taken_us = channel().TC_CV.read() / kCountsPer_us;
  TickTiming result;
  result.late = late;
  result.last_us = static_cast<std::uint16_t>(taken_us + (late ? link::kTick_us : 0U));
  return result;
}

}  // namespace heli::due::tick_timer
