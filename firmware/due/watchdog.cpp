// Mode and restart of the chip's watchdog; see watchdog.hpp.
#include "drivers.hpp"
#include "registers.hpp"

namespace heli::due::watchdog {
namespace {

// In periods of 128 slow clocks; 27 pass. The slow clock is an RC oscillator of 20 to 44 kHz, so
// the timeout is 78 to 173 ms.
constexpr std::uint32_t kTimeout = 26;

// Ticks between two restarts: a fifth of the shortest timeout. Each restart has to cross into the
// slow clock's domain, so more frequent ones would bring nothing.
constexpr std::uint32_t kInterval = 16;

std::uint32_t restarted_at;  // in ticks

}  // namespace

void start() {
  // WDD = WDV: no forbidden window. Without WDRPROC, which is reported not to reset a Due, and
  // without WDIDLEHLT: a processor that sleeps because its tick died must be reset.
  WDT->WDT_MR.write(WDT_MR_WDV(kTimeout) | WDT_MR_WDD(kTimeout) | WDT_MR_WDRSTEN | WDT_MR_WDDBGHLT);
}

void check_in(std::uint32_t ticks) {
  // This call shows that the idle loop runs; a change of `ticks` shows that the tick runs.
  if (ticks - restarted_at < kInterval) return;
  restarted_at = ticks;
  WDT->WDT_CR.write(WDT_CR_KEY(0xA5) | WDT_CR_WDRSTT);
}

}  // namespace heli::due::watchdog
