// Switches the chip to 84 MHz: crystal 12 MHz, PLL times 14, halved. Runs once, at the start.
#include "drivers.hpp"
#include "registers.hpp"

namespace heli::due::clock {
namespace {

constexpr std::uint32_t kCrystal_Hz = 12000000;
constexpr std::uint32_t kPllMultiplier = 14;
static_assert(kCrystal_Hz * kPllMultiplier / 2 == kMck_Hz, "the PLL halved is the master clock");

constexpr std::uint32_t kKey = CKGR_MOR_KEY(0x37);
// Start-up of the crystal in 8 periods of the slow clock: 2 ms at 32 kHz, as Arduino's core has it.
constexpr std::uint32_t kCrystalStart = CKGR_MOR_MOSCXTST(8);
constexpr std::uint32_t kPllStart = CKGR_PLLAR_PLLACOUNT(0x3F);
// Flash reads at 84 MHz need four wait states (datasheet, embedded flash characteristics).
constexpr std::uint32_t kFlashWaitStates = EEFC_FMR_FWS(4);

// A turn of the loop takes six cycles or more: 30 ms on the 4 MHz oscillator.
constexpr std::uint32_t kMaxPolls = 20000;

// Waits for bits of PMC_SR; false if they do not come in time.
bool wait_for(std::uint32_t ready) {
  for (std::uint32_t i = 0; i < kMaxPolls; ++i) {
    if ((PMC->PMC_SR.read() & ready) != 0U) return true;
  }
  return false;
}

// Selects source and prescaler of the master clock; false if it does not become ready in time.
bool select(std::uint32_t mckr) {
  PMC->PMC_MCKR.write(mckr);
  return wait_for(PMC_SR_MCKRDY);
}

}  // namespace

bool start() {
  // The flash first: it must be slow enough before the clock becomes fast.
  EFC0->EEFC_FMR.write(kFlashWaitStates);
  EFC1->EEFC_FMR.write(kFlashWaitStates);

  constexpr std::uint32_t kOscillators =
      kKey | kCrystalStart | CKGR_MOR_MOSCRCEN | CKGR_MOR_MOSCXTEN;
  PMC->CKGR_MOR.write(kOscillators);
  if (!wait_for(PMC_SR_MOSCXTS)) return false;
  PMC->CKGR_MOR.write(kOscillators | CKGR_MOR_MOSCSEL);
  if (!wait_for(PMC_SR_MOSCSELS)) return false;
  if (!select(PMC_MCKR_CSS_MAIN_CLK)) return false;

  PMC->CKGR_PLLAR.write(CKGR_PLLAR_ONE | CKGR_PLLAR_MULA(kPllMultiplier - 1) | kPllStart |
                        CKGR_PLLAR_DIVA(1));
  if (!wait_for(PMC_SR_LOCKA)) return false;
  // Prescaler before source: in the other order the chip would run at 168 MHz for a moment.
  return select(PMC_MCKR_PRES_CLK_2 | PMC_MCKR_CSS_MAIN_CLK) &&
         select(PMC_MCKR_PRES_CLK_2 | PMC_MCKR_CSS_PLLA_CLK);
}

}  // namespace heli::due::clock
