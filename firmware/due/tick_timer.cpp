// Two channels of timer block TC1: one makes the tick's interrupt, the other measures time.
#include <cstdint>

#include "core.hpp"
#include "cortex_m3.hpp"
#include "drivers.hpp"
#include "link/declaration.hpp"
#include "registers.hpp"

namespace heli::due::tick_timer {
namespace {

// TIMER_CLOCK1 is half the master clock.
constexpr std::uint32_t kCountsPer_us = clock::kMck_Hz / 2 / 1000000;
constexpr std::uint32_t kPeriod = link::kTick_us * kCountsPer_us;
constexpr std::uint32_t kMax_us = 0xFFFF;

// None of TC1's pins is brought out on the Due. tick_channel() restarts at every tick.
// free_channel() never does: it shows how many ticks were missed, because an interrupt that comes
// twice before it is served runs only once.
TcChannel& tick_channel() { return TC1->TC_CHANNEL[0]; }
TcChannel& free_channel() { return TC1->TC_CHANNEL[1]; }
constexpr unsigned kInterrupt = ID_TC3;

std::uint32_t due_count;     // when this tick was due, by running()
std::uint32_t missed_ticks;  // ticks between this one and the one before

}  // namespace

void start() {
  PMC->PMC_PCER0.write(bit(ID_TC3) | bit(ID_TC4));
  free_channel().TC_CMR.write(TC_CMR_TCCLKS_TIMER_CLOCK1 | TC_CMR_WAVE);
  free_channel().TC_CCR.write(TC_CCR_CLKEN | TC_CCR_SWTRG);
  tick_channel().TC_CMR.write(TC_CMR_TCCLKS_TIMER_CLOCK1 | TC_CMR_WAVE | TC_CMR_WAVSEL_UP_RC);
  tick_channel().TC_RC.write(kPeriod);
  tick_channel().TC_IER.write(TC_IER_CPCS);
  enable_interrupt(kInterrupt, kTickPriority);
  tick_channel().TC_CCR.write(TC_CCR_CLKEN | TC_CCR_SWTRG);
}

void acknowledge() {
  static_cast<void>(tick_channel().TC_SR.read());
  // Reads both counters at every tick, so that no difference between them accumulates.
  const std::uint32_t since_due = tick_channel().TC_CV.read();
  const std::uint32_t due = free_channel().TC_CV.read() - since_due;
  missed_ticks = (due - due_count + kPeriod / 2) / kPeriod - 1;
  due_count = due;
}

TickTiming timing() {
  const std::uint32_t elapsed = free_channel().TC_CV.read() - due_count;
  const std::uint32_t elapsed_us = missed_ticks * link::kTick_us + elapsed / kCountsPer_us;
  TickTiming result;
  result.late = missed_ticks > 0 || elapsed >= kPeriod;
  result.last_us = static_cast<std::uint16_t>(elapsed_us < kMax_us ? elapsed_us : kMax_us);
  return result;
}

}  // namespace heli::due::tick_timer
