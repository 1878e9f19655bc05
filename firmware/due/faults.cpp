// The fault handlers: motors off, record in the backup registers (which a reset keeps), reset.
#include <cstdint>

#include "cortex_m3.hpp"
#include "drivers.hpp"
#include "link/declaration.hpp"
#include "motors.hpp"
#include "registers.hpp"

namespace heli::due::faults {
namespace {

constexpr std::uint8_t kDue = 1;  // BootReport::board

// Words of the backup registers. All but kRecord keep their values after the report, for a
// debugger.
enum Word : unsigned { kRecord, kPc, kLr, kCfsr, kBfar };
// Upper half of kRecord; the fault's code is the low byte, the exception number the byte above it.
constexpr std::uint32_t kMagic = 0x48460000;
constexpr std::uint32_t kMagicMask = 0xFFFF0000;
// The boot event carries it as a float, which holds 24 bits.
constexpr std::uint32_t kBootIdMask = 0x00FFFFFF;

// RSTC_SR.RSTTYP
enum ResetType : std::uint32_t {
  kGeneral = 0,
  kBackup = 1,
  kWatchdog = 2,
  kSoftware = 3,
  kUser = 4
};

// Exception numbers; bus and memory faults are in between.
constexpr std::uint32_t kHardFault = 3;
constexpr std::uint32_t kUsageFault = 6;

// Words of the frame that the processor puts on the stack (ARMv7-M B1.5.6).
constexpr std::uint32_t kFramePc = 6;
constexpr std::uint32_t kFrameLr = 5;
constexpr std::uint32_t kFrameWords = 8;

std::uint8_t code(link::Fault fault) { return static_cast<std::uint8_t>(fault); }

// Writes the record that read_boot_report() finds after the reset.
void record(link::Fault fault, std::uint32_t exception) {
  GPBR->SYS_GPBR[kRecord].write(kMagic | (exception & 0xFFU) << 8U | code(fault));
  GPBR->SYS_GPBR[kCfsr].write(SCB->CFSR.read());
  GPBR->SYS_GPBR[kBfar].write(SCB->BFAR.read());
}

[[noreturn]] void reset_chip() {
  wait_for_writes();
  RSTC->RSTC_CR.write(RSTC_CR_KEY(0xA5) | RSTC_CR_PROCRST | RSTC_CR_PERRST);
  for (;;) {
  }
}

}  // namespace

BootReport read_boot_report() {
  const std::uint32_t type = RSTC_SR_RSTTYP.of(RSTC->RSTC_SR.read());
  const std::uint32_t recorded = GPBR->SYS_GPBR[kRecord].read();
  GPBR->SYS_GPBR[kRecord].write(0);

  BootReport report{};
  report.board = kDue;
  link::Reset reset = link::Reset::power_up;
  if (type == kWatchdog) reset = link::Reset::watchdog;
  if (type == kSoftware) reset = link::Reset::software;
  if (type == kUser) reset = link::Reset::user;
  report.reset = static_cast<std::uint8_t>(reset);

  // At power-up the backup registers hold nothing. If a watchdog reset finds a record, the fault
  // handler made it and then hung; so the record is reported.
  if (reset != link::Reset::power_up) {
    if (reset == link::Reset::watchdog) report.boot_fault = code(link::Fault::watchdog);
    if ((recorded & kMagicMask) == kMagic && reset != link::Reset::user) {
      report.boot_fault = static_cast<std::uint8_t>(recorded);
    }
  }
  report.boot_id = random::bits() & kBootIdMask;
  return report;
}

[[noreturn]] void give_up() {
  mask_interrupts();
  motors::cut();
  record(link::Fault::hard_fault, 0);
  reset_chip();
}

}  // namespace heli::due::faults

extern "C" {

// The stack may have caused the fault, so the handler runs with the stack pointer at the top again.
// Passes the old stack pointer, which points to the processor's frame.
[[gnu::naked]] void fault_entry() {
  asm volatile(
      "cpsid i\n\t"
      "mov r0, sp\n\t"
      "ldr r1, =__stack_top\n\t"
      "mov sp, r1\n\t"
      "b fault_handler\n\t");
}

[[gnu::used]] void fault_handler(const std::uint32_t* frame) {
  using namespace heli::due;
  using namespace heli::due::faults;
  motors::cut();
  const std::uint32_t exception = exception_number();
  const bool fault = exception >= kHardFault && exception <= kUsageFault;
  record(fault ? heli::link::Fault::hard_fault : heli::link::Fault::unexpected_interrupt,
         exception);
  if (frame >= __stack_bottom && frame + kFrameWords <= __stack_top) {
    GPBR->SYS_GPBR[kPc].write(frame[kFramePc]);
    GPBR->SYS_GPBR[kLr].write(frame[kFrameLr]);
  }
  reset_chip();
}

}  // extern "C"
