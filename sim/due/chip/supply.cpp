// Registers of watchdog, reset controller, backup registers and chip identifier; see supply.hpp.
#include "chip/supply.hpp"

namespace due_emulator {

namespace {

using access::kBoth;
using access::kRead;
using access::kWrite;

constexpr Register kWdtRegisters[] = {
    {0x0, "WDT_CR", kWrite}, {0x4, "WDT_MR", kBoth}, {0x8, "WDT_SR", kRead}};
constexpr Register kRstcRegisters[] = {
    {0x0, "RSTC_CR", kWrite}, {0x4, "RSTC_SR", kRead}, {0x8, "RSTC_MR", kBoth}};
constexpr Register kGpbrRegisters[] = {
    {0x00, "GPBR0", kBoth}, {0x04, "GPBR1", kBoth}, {0x08, "GPBR2", kBoth}, {0x0C, "GPBR3", kBoth},
    {0x10, "GPBR4", kBoth}, {0x14, "GPBR5", kBoth}, {0x18, "GPBR6", kBoth}, {0x1C, "GPBR7", kBoth}};
constexpr Register kChipIdRegisters[] = {{0x0, "CHIPID_CIDR", kRead}, {0x4, "CHIPID_EXID", kRead}};

constexpr std::uint32_t kSystemKey = 0xA5;

// Offsets of registers.
constexpr std::uint32_t kWdtMr = 0x4;
constexpr std::uint32_t kRstcMr = 0x8;

// WDT_MR
constexpr std::uint32_t kWdtFaultInterrupt = 1U << 12;
constexpr std::uint32_t kWdtResetEnable = 1U << 13;
constexpr std::uint32_t kWdtProcessorOnly = 1U << 14;
constexpr std::uint32_t kWdtDisable = 1U << 15;
constexpr std::uint32_t kWdtIdleHalt = 1U << 29;
constexpr std::uint32_t kWdtMrMask = 0x3FFFFFFF;
constexpr std::uint32_t kWdtMrReset = 0x3FFF2FFF;  // on, about 16 s, with reset
constexpr std::uint32_t kWdtDivider = 128;         // periods of the slow clock per count
// WDT_SR
constexpr std::uint32_t kWdtUnderflow = 1U << 0;
constexpr std::uint32_t kWdtError = 1U << 1;
constexpr std::uint32_t kWdtRestart = 1U << 0;  // WDT_CR.WDRSTT

constexpr std::uint32_t kProcRst = 1U << 0;  // RSTC_CR
constexpr std::uint32_t kPerRst = 1U << 2;
constexpr std::uint32_t kUrsts = 1U << 0;  // RSTC_SR
constexpr unsigned kRstTypShift = 8;
constexpr std::uint32_t kNrstl = 1U << 16;
constexpr std::uint32_t kUrstEn = 1U << 0;  // RSTC_MR
constexpr std::uint32_t kUrstIen = 1U << 4;
constexpr std::uint32_t kRstcMrMask = 0xF11;  // ERSTL, URSTIEN, URSTEN

}  // namespace

// -- WDT --------------------------------------------------------------------------------------

Wdt::Wdt(System& system)
    : Peripheral(system, "WDT", 0x400E1A50, 0x10, kAlwaysClocked, kWdtRegisters),
      id_(system.scheduler.add(this)) {}

void Wdt::reset() {
  mode_ = kWdtMrReset;
  written_ = false;
  status_ = 0;
  system_.set_irq(id::kWdt, false);
  restart();
}

// Loads the counter with WDT_MR.WDV.
void Wdt::restart() {
  start_ = system_.board_now();
  sleep_at_start_ = system_.cpu.sleep_cycles();
  plan();
}

// Board time that the counter has run since it was loaded; with WDIDLEHLT it stops while the
// processor sleeps.
BoardTime Wdt::passed() const {
  BoardTime time = system_.board_now() - start_;
  if ((mode_ & kWdtIdleHalt) != 0) {
    const std::uint64_t slept = system_.cpu.sleep_cycles() - sleep_at_start_;
    const BoardTime idle = slept * (BoardTime{kFull_Hz} * kOneCycle / system_.clock.mck_Hz());
    time = time > idle ? time - idle : 0;
  }
  return time;
}

// Schedules event() for the underflow.
void Wdt::plan() {
  if ((mode_ & kWdtDisable) != 0) return system_.scheduler.set(id_, kNever);
  const BoardTime whole = system_.slow_periods((std::uint64_t{value()} + 1) * kWdtDivider);
  const BoardTime run = passed();
  const BoardTime left = whole > run ? whole - run : 0;
  system_.scheduler.set(id_, system_.clock.cycle_at(system_.board_now() + left));
}

// The time of the underflow, unless the processor has slept meanwhile.
void Wdt::event(std::uint64_t) {
  const BoardTime whole = system_.slow_periods((std::uint64_t{value()} + 1) * kWdtDivider);
  if (passed() < whole) return plan();
  fail(kWdtUnderflow);
}

// An underflow, or a restart outside of the window: interrupt or reset, as WDT_MR says.
void Wdt::fail(std::uint32_t error) {
  status_ |= error;
  if ((mode_ & kWdtFaultInterrupt) != 0) system_.set_irq(id::kWdt, true);
  if ((mode_ & kWdtResetEnable) != 0) {
    system_.request_reset(ResetType::kWatchdog, (mode_ & kWdtProcessorOnly) != 0);
    return;
  }
  restart();
}

// WDT_MR, or WDT_SR, which reading clears.
std::uint32_t Wdt::read(std::uint32_t offset) {
  if (offset == kWdtMr) return mode_;
  const std::uint32_t value = status_;
  status_ = 0;
  system_.set_irq(id::kWdt, false);
  return value;
}

// WDT_MR can be written once after a reset. WDT_CR restarts the counter, which is an error while it
// is above the window WDD.
void Wdt::write(std::uint32_t offset, std::uint32_t value) {
  if (offset == kWdtMr) {
    if (written_) return misuse(offset, "second write after a reset; the first one counts");
    written_ = true;
    mode_ = value & kWdtMrMask;
    return restart();
  }
  if ((value >> 24) != kSystemKey) return misuse(offset, "write without the key 0xA5");
  if ((value & kWdtRestart) == 0 || (mode_ & kWdtDisable) != 0) return;
  const BoardTime step = system_.slow_periods(kWdtDivider);
  const std::uint64_t steps = passed() / step;
  const std::uint64_t counter = steps > this->value() ? 0 : this->value() - steps;
  if (counter > window()) return fail(kWdtError);
  ++restarts_;
  restart();
}

// -- RSTC -------------------------------------------------------------------------------------

Rstc::Rstc(System& system)
    : Peripheral(system, "RSTC", 0x400E1A00, 0x10, kAlwaysClocked, kRstcRegisters) {}

void Rstc::note(ResetType type) {
  type_ = type;
  user_seen_ = false;
}

// The NRST pin: a falling edge is a user reset if URSTEN allows it.
void Rstc::set_nrst(bool low) {
  if (low && !nrst_low_) {
    user_seen_ = true;
    if ((mode_ & kUrstEn) != 0) system_.request_reset(ResetType::kUser);
  }
  nrst_low_ = low;
}

// RSTC_MR, or RSTC_SR with the last reset's type and the level of NRST.
std::uint32_t Rstc::read(std::uint32_t offset) {
  if (offset == kRstcMr) return mode_;
  // RSTC_SR: reading clears URSTS.
  const std::uint32_t value = (user_seen_ ? kUrsts : 0U) |
                              (static_cast<std::uint32_t>(type_) << kRstTypShift) |
                              (nrst_low_ ? 0U : kNrstl);
  user_seen_ = false;
  return value;
}

// RSTC_CR resets the processor, with PERRST the peripherals too; RSTC_MR allows user resets by
// NRST.
void Rstc::write(std::uint32_t offset, std::uint32_t value) {
  if ((value >> 24) != kSystemKey) return misuse(offset, "write without the key 0xA5");
  if (offset == kRstcMr) {
    mode_ = value & kRstcMrMask;
    if ((value & kUrstIen) != 0) not_modelled(offset, "the user reset interrupt is not modelled");
    return;
  }
  // RSTC_CR
  if ((value & (kProcRst | kPerRst)) == kPerRst)
    return not_modelled(offset, "a reset of the peripherals alone");
  if ((value & kProcRst) != 0) {
    system_.request_reset(ResetType::kSoftware, (value & kPerRst) == 0);
  }
}

// -- GPBR and CHIPID --------------------------------------------------------------------------

Gpbr::Gpbr(System& system)
    : Peripheral(system, "GPBR", 0x400E1A90, 0x20, kAlwaysClocked, kGpbrRegisters) {}

ChipId::ChipId(System& system)
    : Peripheral(system, "CHIPID", 0x400E0940, 0x10, kAlwaysClocked, kChipIdRegisters) {}

}  // namespace due_emulator
