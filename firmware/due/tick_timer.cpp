#include "tick_timer.hpp"

#include <cstdint>

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
constexpr std::uint32_t kMax_us = 0xFFFF;

// Of the block TC1, none of whose pins is brought out on the Due: one channel restarts at every
// tick, the other never, because an interrupt that comes twice before it is served comes once.
TcChannel& ticker() { return TC1->TC_CHANNEL[0]; }
TcChannel& running() { return TC1->TC_CHANNEL[1]; }
constexpr unsigned kInterrupt = ID_TC3;

std::uint32_t due_at;  // when this tick was due, by running()
std::uint32_t missed;  // ticks between this one and the one before

}  // namespace

void start() {
  PMC->PMC_PCER0.write(bit(ID_TC3) | bit(ID_TC4));
  running().TC_CMR.write(TC_CMR_TCCLKS_TIMER_CLOCK1 | TC_CMR_WAVE);
  running().TC_CCR.write(TC_CCR_CLKEN | TC_CCR_SWTRG);
  ticker().TC_CMR.write(TC_CMR_TCCLKS_TIMER_CLOCK1 | TC_CMR_WAVE | TC_CMR_WAVSEL_UP_RC);
  ticker().TC_RC.write(kPeriod);
  ticker().TC_IER.write(TC_IER_CPCS);
  enable_interrupt(kInterrupt, kTickPriority);
  ticker().TC_CCR.write(TC_CCR_CLKEN | TC_CCR_SWTRG);
}

void acknowledge() {
  static_cast<void>(ticker().TC_SR.read());
  // Both counters anew at every tick, so that no difference between them adds up.
  const std::uint32_t since_due = ticker().TC_CV.read();
  const std::uint32_t due = running().TC_CV.read() - since_due;
  missed = (due - due_at + kPeriod / 2) / kPeriod - 1;
  due_at = due;
}

TickTiming timing() {
  const std::uint32_t taken = running().TC_CV.read() - due_at;
  const std::uint32_t taken_us = missed * link::kTick_us + taken / kCountsPer_us;
  TickTiming result;
  result.late = missed > 0 || taken >= kPeriod;
  result.last_us = static_cast<std::uint16_t>(taken_us < kMax_us ? taken_us : kMax_us);
  return result;
}

}  // namespace heli::due::tick_timer
