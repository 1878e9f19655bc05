// Oscillators, PLL, master clock and peripheral clocks; see pmc.hpp.
#include "chip/pmc.hpp"

#include <algorithm>

// Registers of the PMC and their bits by the datasheet's names (section 28).
namespace due_emulator::pmc {

using access::kBoth;
using access::kProtected;
using access::kRead;
using access::kUnmodelled;
using access::kWrite;

constexpr Register kRegisters[] = {
    {0x000, "PMC_SCER", kWrite | kProtected},
    {0x004, "PMC_SCDR", kWrite | kProtected},
    {0x008, "PMC_SCSR", kRead},
    {0x010, "PMC_PCER0", kWrite | kProtected},
    {0x014, "PMC_PCDR0", kWrite | kProtected},
    {0x018, "PMC_PCSR0", kRead},
    {0x01C, "CKGR_UCKR", kBoth | kProtected},
    {0x020, "CKGR_MOR", kBoth | kProtected},
    {0x024, "CKGR_MCFR", kRead},
    {0x028, "CKGR_PLLAR", kBoth | kProtected},
    {0x030, "PMC_MCKR", kBoth | kProtected},
    {0x038, "PMC_USB", kBoth | kProtected},
    {0x040, "PMC_PCK0", kBoth | kUnmodelled},
    {0x044, "PMC_PCK1", kBoth | kUnmodelled},
    {0x048, "PMC_PCK2", kBoth | kUnmodelled},
    {0x060, "PMC_IER", kWrite | kUnmodelled},
    {0x064, "PMC_IDR", kWrite | kUnmodelled},
    {0x068, "PMC_SR", kRead},
    {0x06C, "PMC_IMR", kRead | kUnmodelled},
    {0x070, "PMC_FSMR", kBoth | kUnmodelled},
    {0x074, "PMC_FSPR", kBoth | kUnmodelled},
    {0x078, "PMC_FOCR", kWrite | kUnmodelled},
    {0x0E4, "PMC_WPMR", kBoth},
    {0x0E8, "PMC_WPSR", kRead},
    {0x100, "PMC_PCER1", kWrite | kProtected},
    {0x104, "PMC_PCDR1", kWrite | kProtected},
    {0x108, "PMC_PCSR1", kRead},
    {0x10C, "PMC_PCR", kBoth | kUnmodelled},
};

// Offsets of the registers that the model names.
constexpr std::uint32_t kScer = 0x00;
constexpr std::uint32_t kScdr = 0x04;
constexpr std::uint32_t kScsr = 0x08;
constexpr std::uint32_t kPcer0 = 0x10;
constexpr std::uint32_t kPcdr0 = 0x14;
constexpr std::uint32_t kPcsr0 = 0x18;
constexpr std::uint32_t kUckr = 0x1C;
constexpr std::uint32_t kMor = 0x20;
constexpr std::uint32_t kMcfr = 0x24;
constexpr std::uint32_t kPllar = 0x28;
constexpr std::uint32_t kMckr = 0x30;
constexpr std::uint32_t kUsb = 0x38;
constexpr std::uint32_t kSr = 0x68;
constexpr std::uint32_t kWpmr = 0xE4;
constexpr std::uint32_t kPcer1 = 0x100;
constexpr std::uint32_t kPcdr1 = 0x104;
constexpr std::uint32_t kPcsr1 = 0x108;

// CKGR_MOR
constexpr std::uint32_t kMoscXtEn = 1U << 0;
constexpr std::uint32_t kMoscRcEn = 1U << 3;
constexpr std::uint32_t kMoscSel = 1U << 24;

// PMC_SR
constexpr std::uint32_t kMoscXtS = 1U << 0;
constexpr std::uint32_t kLockA = 1U << 1;
constexpr std::uint32_t kMckRdy = 1U << 3;
constexpr std::uint32_t kLockU = 1U << 6;
constexpr std::uint32_t kMoscSelS = 1U << 16;
constexpr std::uint32_t kMoscRcS = 1U << 17;

// CKGR_UCKR: bits that no field names read as they do after reset until they are written.
constexpr std::uint32_t kUckrReset = 0x10200800;
constexpr std::uint32_t kUpllEn = 1U << 16;
// PMC_SCSR.UOTGCLK, the 48 MHz of the USB port; bit 0 always reads 1.
constexpr std::uint32_t kUsbClock = 1U << 5;

}  // namespace due_emulator::pmc

namespace due_emulator {

namespace {

using namespace pmc;

constexpr std::uint32_t kCrystal_Hz = 12000000;
// PMC_MCKR: CSS chooses the source of the master clock, PRES divides it.
constexpr std::uint32_t kCss = 3;
constexpr std::uint32_t kCssPlla = 2;
constexpr std::uint32_t kCssUpll = 3;
constexpr std::uint32_t kPres = 7U << 4;
constexpr std::uint32_t kPllaDiv2 = 1U << 12;
constexpr std::uint32_t kMckrMask = 0x3073;  // CSS, PRES, PLLADIV2, UPLLDIV2
constexpr std::uint32_t kPllarOne = 1U << 29;
constexpr std::uint32_t kUsbs = 1;       // PMC_USB.USBS: UPLL, otherwise PLLA
constexpr std::uint32_t kPck = 7U << 8;  // PMC_SCER.PCK0 to PCK2

// Fields of CKGR_MOR, CKGR_PLLAR, CKGR_UCKR and PMC_MCKR.
constexpr Field kMoscRcf{4, 2};
constexpr Field kMoscXtSt{8, 8};
constexpr Field kMorKeyField{16, 8};
constexpr Field kDivA{0, 8};
constexpr Field kPllaCount{8, 6};
constexpr Field kMulA{16, 11};
constexpr Field kUpllCount{20, 4};
constexpr Field kPresField{4, 3};

constexpr std::uint32_t kUsbMask = 0xF01;    // PMC_USB: USBDIV, USBS
constexpr std::uint32_t kProtect = 1U << 0;  // PMC_WPMR.WPEN
constexpr std::uint32_t kMorKey = 0x37;
constexpr std::uint32_t kProtectKey = 0x504D43;
// Peripherals 8 to 44 have a clock that can be switched; RSTC to EEFC always run.
constexpr std::uint64_t kSwitchable = ((std::uint64_t{1} << 45) - 1) & ~std::uint64_t{0xFF};
// A change of prescaler or source settles within a few cycles of the slower clock.
constexpr std::uint64_t kSwitchCycles = 8;
// PLLA runs from 84 to 192 MHz.
constexpr std::uint32_t kPllaLowest_Hz = 84000000;
constexpr std::uint32_t kPllaHighest_Hz = 192000000;
// A 12 MHz crystal's start and the PLLs' at their slowest. PMC_SR says only that the counters
// MOSCXTST, PLLACOUNT and UPLLCOUNT have run down, which it is the program's business to choose.
// UPLL's time is not from the datasheet: it is below what one step of UPLLCOUNT gives.
constexpr BoardTime kCrystalStart = 1400 * kOneUs;
constexpr BoardTime kPllaStart = 200 * kOneUs;
constexpr BoardTime kUpllStart = 100 * kOneUs;

}  // namespace

Pmc::Pmc(System& system)
    : Peripheral(system, "PMC", 0x400E0600, 0x200, kAlwaysClocked, kRegisters),
      id_(system.scheduler.add(this)) {}

// After reset the chip runs from the RC oscillator at 4 MHz, and all peripheral clocks are off.
void Pmc::reset() {
  main_oscillator_ = kMoscRcEn;
  plla_ = 0x3F00;  // PLLACOUNT
  upll_ = kUckrReset;
  usb_ = 0;
  system_clocks_ = 1;  // bit 0 always reads 1
  master_ = 1;         // CSS: the main clock
  status_ = kMckRdy | kMoscSelS | kMoscRcS;
  protect_ = 0;
  crystal_ready_ = plla_ready_ = upll_ready_ = master_ready_ = 0;
  system_.peripheral_clocks = 0;
  system_.upll_locked = false;
  apply_master_clock();
  plan();
}

// The main clock: the crystal, or the RC oscillator at the frequency in CKGR_MOR.MOSCRCF.
std::uint32_t Pmc::main_Hz() const {
  if ((main_oscillator_ & kMoscSel) != 0) return kCrystal_Hz;
  static constexpr std::uint32_t kRc_Hz[] = {4000000, 8000000, 12000000, 12000000};
  return kRc_Hz[kMoscRcf.of(main_oscillator_)];
}

// PLLA: main clock / DIVA * (MULA + 1); 0 Hz while it is off.
std::uint32_t Pmc::plla_Hz() const {
  const std::uint32_t divider = kDivA.of(plla_);
  const std::uint32_t multiplier = kMulA.of(plla_);
  if (divider == 0 || multiplier == 0) return 0;
  return main_Hz() / divider * (multiplier + 1);
}

// The master clock that a value of PMC_MCKR gives; 0 Hz if its source is off or not modelled.
std::uint32_t Pmc::master_Hz(std::uint32_t mckr) const {
  std::uint32_t hz = 0;
  switch (mckr & kCss) {
    case 0:
      hz = system_.slow_Hz;
      break;
    case 1:
      hz = main_Hz();
      break;
    case kCssPlla:
      hz = plla_Hz() / ((mckr & kPllaDiv2) != 0 ? 2U : 1U);
      break;
    default:
      break;
  }
  const std::uint32_t prescaler = kPresField.of(mckr);
  // PRES 7 divides by 3, the others by powers of 2.
  return prescaler == 7 ? hz / 3 : hz >> prescaler;
}

// Lets the chip run at the master clock that the registers give. Reports a clock that is too fast
// for the chip or for the flash's wait states.
void Pmc::apply_master_clock() {
  const std::uint32_t hz = master_Hz(master_);
  if (hz == 0) {
    misuse(kMckr, "the source of the master clock is not running");
    return;
  }
  if (hz > kFull_Hz)
    misuse(kMckr, "a master clock of " + std::to_string(hz) + " Hz is above 84 MHz");
  for (std::size_t plane = 0; plane < system_.flash_wait_states.size(); ++plane) {
    const std::uint32_t wait_states = system_.flash_wait_states[plane];
    if (hz <= flash_limit_Hz(wait_states)) continue;
    misuse(kMckr, "a master clock of " + std::to_string(hz) +
                      " Hz needs more flash wait states than FWS = " + std::to_string(wait_states) +
                      " of EFC" + std::to_string(plane));
  }
  system_.change_mck(hz);
}

// Moves what has become ready by now into the status register.
void Pmc::settle() {
  const BoardTime now = system_.board_now();
  const auto due = [now](BoardTime& ready) {
    if (ready == 0 || now < ready) return false;
    ready = 0;
    return true;
  };
  if (due(crystal_ready_)) status_ |= kMoscXtS;
  if (due(plla_ready_)) status_ |= kLockA;
  if (due(upll_ready_)) status_ |= kLockU;
  system_.upll_locked = (status_ & kLockU) != 0;
  if (due(master_ready_)) status_ |= kMckRdy;
}

// Schedules event() for the next oscillator or PLL that becomes ready.
void Pmc::plan() {
  BoardTime first = ~BoardTime{0};
  for (const BoardTime ready : {crystal_ready_, plla_ready_, upll_ready_, master_ready_}) {
    if (ready != 0) first = std::min(first, ready);
  }
  system_.scheduler.set(id_, first == ~BoardTime{0} ? kNever : system_.clock.cycle_at(first));
}

void Pmc::event(std::uint64_t) {
  settle();
  plan();
}

// Status first becomes what it is at this time.
std::uint32_t Pmc::read(std::uint32_t offset) {
  settle();
  switch (offset) {
    case kScsr:
      return system_clocks_;
    case kPcsr0:
      return static_cast<std::uint32_t>(system_.peripheral_clocks);
    case kPcsr1:
      return static_cast<std::uint32_t>(system_.peripheral_clocks >> 32);
    case kUckr:
      return upll_;
    case kMor:
      return main_oscillator_;
    // Main clock cycles in 16 periods of the slow clock, and that the count is complete.
    case kMcfr:
      return (1U << 16) |
             static_cast<std::uint32_t>(std::uint64_t{main_Hz()} * 16 / system_.slow_Hz);
    case kPllar:
      return plla_;
    case kMckr:
      return master_;
    case kUsb:
      return usb_;
    case kSr:
      return status_;
    case kWpmr:
      return protect_;
    default:
      return 0;
  }
}

// CKGR_MOR: switches crystal and RC oscillator, and chooses the main clock.
void Pmc::write_main_oscillator(std::uint32_t value) {
  if (kMorKeyField.of(value) != kMorKey) return misuse(kMor, "write without the key 0x37");
  const std::uint32_t before = main_oscillator_;
  main_oscillator_ = value & ~0x00FF0000U;  // KEY reads 0
  if ((value & kMoscXtEn) != 0 && (before & kMoscXtEn) == 0) {
    // MOSCXTST counts eight periods of the slow clock each.
    const std::uint32_t startup = 8 * kMoscXtSt.of(value);
    crystal_ready_ = system_.board_now() + system_.slow_periods(startup + 1);
    crystal_steady_ = system_.board_now() + kCrystalStart;
  }
  if ((value & kMoscXtEn) == 0) {
    crystal_ready_ = 0;
    status_ &= ~kMoscXtS;
  }
  status_ = (value & kMoscRcEn) != 0 ? status_ | kMoscRcS : status_ & ~kMoscRcS;
  const bool crystal = (value & kMoscSel) != 0;
  if (crystal && (status_ & kMoscXtS) == 0) {
    misuse(kMor, "the crystal is chosen before PMC_SR.MOSCXTS says that it runs");
  } else if (crystal && system_.board_now() < crystal_steady_) {
    misuse(kMor, "CKGR_MOR.MOSCXTST is too short: the crystal needs 1.4 ms to start");
  }
  if (!crystal && (value & kMoscRcEn) == 0)
    misuse(kMor, "no oscillator is left for the main clock");
  plan();
  apply_master_clock();
}

// CKGR_PLLAR: PLLA begins to lock at its new frequency.
void Pmc::write_plla(std::uint32_t value) {
  if ((value & kPllarOne) == 0) return misuse(kPllar, "write without bit 29, which must be 1");
  if ((master_ & kCss) == kCssPlla)
    misuse(kPllar, "PLLA is changed while the master clock runs from it");
  plla_ = value & ~kPllarOne;
  status_ &= ~kLockA;
  const std::uint32_t hz = plla_Hz();
  plla_ready_ = 0;
  if (hz != 0) {
    if (hz < kPllaLowest_Hz || hz > kPllaHighest_Hz) {
      misuse(kPllar, "PLLA at " + std::to_string(hz) + " Hz is outside of 84 to 192 MHz");
    }
    plla_ready_ = system_.board_now() + system_.slow_periods(kPllaCount.of(value) + 1);
    plla_steady_ = system_.board_now() + kPllaStart;
  }
  plan();
}

// UPLL makes 480 MHz of the crystal's 12; UPLLCOUNT counts eight periods of the slow clock each.
void Pmc::write_upll(std::uint32_t value) {
  const bool was_on = (upll_ & kUpllEn) != 0, is_on = (value & kUpllEn) != 0;
  upll_ = value;
  if (!is_on) {
    if ((system_clocks_ & kUsbClock) != 0 && (usb_ & kUsbs) != 0) {
      misuse(kUckr, "UPLL is switched off while the USB clock runs from it");
    }
    status_ &= ~kLockU;
    system_.upll_locked = false;
    upll_ready_ = 0;
  } else if (!was_on) {
    if ((main_oscillator_ & kMoscXtEn) == 0 || system_.board_now() < crystal_steady_) {
      misuse(kUckr, "UPLL is switched on before the 12 MHz crystal runs, which it multiplies");
    }
    const std::uint64_t upllcount = kUpllCount.of(value);
    upll_ready_ = system_.board_now() + system_.slow_periods(8 * upllcount + 1);
    upll_steady_ = system_.board_now() + kUpllStart;
  }
  plan();
}

// PMC_SCER and PMC_SCDR: the USB clock on or off.
void Pmc::write_system_clocks(std::uint32_t offset, std::uint32_t value) {
  if ((value & kPck) != 0) not_modelled(offset, "programmable clocks are not modelled");
  const std::uint32_t bits = value & kUsbClock;
  if (offset == kScdr) {
    system_clocks_ &= ~bits;
    return;
  }
  const bool from_upll = (usb_ & kUsbs) != 0;
  if (bits != 0 && (status_ & (from_upll ? kLockU : kLockA)) == 0) {
    misuse(offset, from_upll
                       ? "the USB clock is switched on before PMC_SR.LOCKU says that UPLL, its "
                         "source in PMC_USB, is stable"
                       : "the USB clock is switched on before PMC_SR.LOCKA says that PLLA, its "
                         "source in PMC_USB, is stable");
  } else if (bits != 0 && from_upll && system_.board_now() < upll_steady_) {
    misuse(offset, "CKGR_UCKR.UPLLCOUNT is too short: UPLL needs 0.1 ms to lock");
  }
  system_clocks_ |= bits;
}

// PMC_MCKR: another source or another prescaler; MCKRDY returns a little later.
void Pmc::write_master_clock(std::uint32_t value) {
  if ((status_ & kMckRdy) == 0) misuse(kMckr, "write before PMC_SR.MCKRDY is set");
  if ((value & kCss) == kCssPlla && (status_ & kLockA) == 0) {
    return misuse(kMckr, "PLLA is chosen before PMC_SR.LOCKA says that it is stable");
  }
  if ((value & kCss) == kCssPlla && system_.board_now() < plla_steady_) {
    misuse(kMckr, "CKGR_PLLAR.PLLACOUNT is too short: PLLA needs 0.2 ms to lock");
  }
  if ((value & kCss) == kCssUpll)
    return not_modelled(kMckr, "a master clock from UPLL is not modelled");
  const bool source = ((value ^ master_) & kCss) != 0;
  const bool prescaler = ((value ^ master_) & (kPres | kPllaDiv2)) != 0;
  if (source && prescaler) {
    misuse(kMckr, "prescaler and source of the master clock must not change in one write");
  }
  master_ = value & kMckrMask;
  apply_master_clock();
  status_ &= ~kMckRdy;
  master_ready_ =
      system_.board_now() + kSwitchCycles * kOneCycle * (kFull_Hz / system_.clock.mck_Hz());
  plan();
}

// PMC_PCER and PMC_PCDR: clocks of peripherals on, or off (offset bit 2). Registers 1 are for the
// identifiers from 32 on.
void Pmc::write_peripheral(std::uint32_t offset, std::uint32_t value) {
  const unsigned shift = offset >= kPcer1 ? 32 : 0;
  const std::uint64_t bits = std::uint64_t{value} << shift;
  if ((bits & ~kSwitchable) != 0)
    misuse(offset, "bits of peripherals that have no clock to switch");
  if ((offset & 4U) == 0) {
    system_.peripheral_clocks |= bits & kSwitchable;
  } else {
    system_.peripheral_clocks &= ~bits;
  }
}

// Each register with its checks; write protection is checked before, in Peripheral.
void Pmc::write(std::uint32_t offset, std::uint32_t value) {
  settle();
  switch (offset) {
    case kScer:
    case kScdr:
      return write_system_clocks(offset, value);
    case kPcer0:
    case kPcdr0:
    case kPcer1:
    case kPcdr1:
      return write_peripheral(offset, value);
    case kUckr:
      return write_upll(value);
    case kMor:
      return write_main_oscillator(value);
    case kPllar:
      return write_plla(value);
    case kMckr:
      return write_master_clock(value);
    case kUsb:
      usb_ = value & kUsbMask;
      return;
    case kWpmr:
      if ((value >> 8) != kProtectKey) return misuse(offset, "write without the key 0x504D43");
      protect_ = value & kProtect;
      return;
    default:
      return;
  }
}

}  // namespace due_emulator
