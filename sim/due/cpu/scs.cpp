// The system control space: NVIC, SCB, SysTick and debug registers; see scs.hpp.
#include "cpu/scs.hpp"

// Registers of the system control space by their names in the ARMv7-M manual (B3.2 to B3.4, C1.6
// and C1.8), and the bits that the model reads or writes.
namespace due_emulator::scs {

// Addresses of the data watchpoint and trace unit, which counts processor cycles.
constexpr std::uint32_t kDwtCtrl = 0xE0001000;
constexpr std::uint32_t kDwtCyccnt = 0xE0001004;
constexpr std::uint32_t kDwtCycCntEna = 1U << 0;     // DWT_CTRL.CYCCNTENA
constexpr std::uint32_t kDwtNumComp = 0x40000000;    // DWT_CTRL.NUMCOMP: 4 comparators
constexpr std::uint32_t kDwtReadOnly = 0xF0000000U;  // NUMCOMP ignores writes

// The system control space is one page; the registers below are offsets in it.
constexpr std::uint32_t kBase = 0xE000E000;
constexpr std::uint32_t kEnd = 0xE000F000;

constexpr std::uint32_t kIctr = 0x004;       // interrupt lines, in groups of 32
constexpr std::uint32_t kActlr = 0x008;      // auxiliary control
constexpr std::uint32_t kSystCsr = 0x010;    // SysTick control and status
constexpr std::uint32_t kSystRvr = 0x014;    // SysTick reload value
constexpr std::uint32_t kSystCvr = 0x018;    // SysTick current value
constexpr std::uint32_t kSystCalib = 0x01C;  // SysTick reload value for a known time

// NVIC. Each of the five bit arrays has one bit per interrupt; NVIC_IPR has one byte.
constexpr std::uint32_t kNvicIser = 0x100;   // set enable
constexpr std::uint32_t kNvicIcer = 0x180;   // clear enable
constexpr std::uint32_t kNvicIspr = 0x200;   // set pending
constexpr std::uint32_t kNvicIcpr = 0x280;   // clear pending
constexpr std::uint32_t kNvicIpr = 0x400;    // priorities
constexpr std::uint32_t kNvicEnd = 0x500;    // the first offset behind NVIC_IPR
constexpr std::uint32_t kNvicArray = 0x780;  // mask: which bit array an offset is in
constexpr std::uint32_t kNvicByte = 0x07F;   // mask: which byte of that array

constexpr std::uint32_t kCpuid = 0xD00;
constexpr std::uint32_t kIcsr = 0xD04;   // interrupt control and state
constexpr std::uint32_t kVtor = 0xD08;   // vector table offset
constexpr std::uint32_t kAircr = 0xD0C;  // priority grouping, system reset
constexpr std::uint32_t kScr = 0xD10;    // sleep
constexpr std::uint32_t kCcr = 0xD14;    // configuration and control
constexpr std::uint32_t kShpr1 = 0xD18;  // priorities of exceptions 4 to 7
constexpr std::uint32_t kShpr2 = 0xD1C;  // 8 to 11
constexpr std::uint32_t kShpr3 = 0xD20;  // 12 to 15
constexpr std::uint32_t kShcsr = 0xD24;  // system handler control and state
constexpr std::uint32_t kCfsr = 0xD28;   // configurable fault status
constexpr std::uint32_t kHfsr = 0xD2C;   // HardFault status
constexpr std::uint32_t kDfsr = 0xD30;   // debug fault status
constexpr std::uint32_t kMmfar = 0xD34;  // address of a MemManage fault
constexpr std::uint32_t kBfar = 0xD38;   // address of a BusFault
constexpr std::uint32_t kAfsr = 0xD3C;   // auxiliary fault status
constexpr std::uint32_t kMpuType = 0xD90;
constexpr std::uint32_t kDhcsr = 0xDF0;  // debug halting control
constexpr std::uint32_t kDemcr = 0xDFC;  // debug exception and monitor control
constexpr std::uint32_t kStir = 0xF00;   // software trigger interrupt

// SYST_CSR
constexpr std::uint32_t kSystEnable = 1U << 0;
constexpr std::uint32_t kSystTickInt = 1U << 1;
constexpr std::uint32_t kSystClkSource = 1U << 2;  // 1: MCK, 0: MCK / 8
constexpr std::uint32_t kSystCountFlag = 1U << 16;
constexpr std::uint32_t kSystCounterMask = 0xFFFFFF;  // the counter has 24 bits

// ICSR
constexpr std::uint32_t kRetToBase = 1U << 11;
constexpr unsigned kVectPendingShift = 12;
constexpr std::uint32_t kIsrPending = 1U << 22;
constexpr std::uint32_t kPendStClr = 1U << 25;
constexpr std::uint32_t kPendStSet = 1U << 26;
constexpr std::uint32_t kPendSvClr = 1U << 27;
constexpr std::uint32_t kPendSvSet = 1U << 28;
constexpr std::uint32_t kNmiPendSet = 1U << 31;

constexpr std::uint32_t kVtorMask = 0x3FFFFF80;  // TBLOFF: a table begins at 128 bytes

// AIRCR. A write needs VECTKEY; a read shows its complement.
constexpr std::uint32_t kVectKey = 0x05FA;
constexpr std::uint32_t kVectKeyStat = 0xFA050000U;
constexpr unsigned kPriGroupShift = 8;
constexpr std::uint32_t kVectReset = 1U << 0;
constexpr std::uint32_t kSysResetReq = 1U << 2;

// SCR: SLEEPONEXIT (bit 1), SLEEPDEEP and SEVONPEND can be written.
constexpr std::uint32_t kSleepDeep = 1U << 2;
constexpr std::uint32_t kSevOnPend = 1U << 4;
constexpr std::uint32_t kScrMask = 0x16;

// CCR: NONBASETHRDENA (bit 0), USERSETMPEND (1), UNALIGN_TRP (3), DIV_0_TRP (4), BFHFNMIGN (8) and
// STKALIGN (9) can be written.
constexpr std::uint32_t kCcrMask = 0x31B;

constexpr std::uint32_t kTrcEna = 1U << 24;        // DEMCR.TRCENA: the trace units run
constexpr std::uint32_t kStirIntId = 0x1FF;        // STIR.INTID: interrupt number
constexpr std::uint32_t kMpuRegions = 0x00000800;  // MPU_TYPE.DREGION: 8

}  // namespace due_emulator::scs

namespace due_emulator {

namespace {

// Values of read-only registers.
constexpr std::uint32_t kCpuId = 0x412FC230;         // Cortex-M3 r2p0
constexpr std::uint32_t kInterruptLines = 1;         // ICTR: 33 to 64 lines
constexpr std::uint32_t kSystickCalib = 0x00002904;  // 1 ms at 84 MHz / 8

// An exception with bits in SHCSR (System Handler Control and State Register).
struct SystemHandler {
  std::uint8_t number;
  std::uint32_t active_bit;
  std::uint32_t pending_bit;
  std::uint32_t enable_bit;
};

constexpr SystemHandler kHandlers[] = {
    {exc::kMemManage, 1U << 0, 1U << 13, 1U << 16},
    {exc::kBusFault, 1U << 1, 1U << 14, 1U << 17},
    {exc::kUsageFault, 1U << 3, 1U << 12, 1U << 18},
    {exc::kSvCall, 1U << 7, 1U << 15, 0},
    {exc::kDebugMonitor, 1U << 8, 0, 0},
    {exc::kPendSv, 1U << 10, 0, 0},
    {exc::kSysTick, 1U << 11, 0, 0},
};

}  // namespace

SystemControl::SystemControl(Cpu& cpu, Exceptions& exceptions, Scheduler& scheduler,
                             Diagnostics& diagnostics)
    : cpu_(cpu),
      exceptions_(exceptions),
      scheduler_(scheduler),
      diagnostics_(diagnostics),
      id_(scheduler.add(this)) {}

void SystemControl::reset() {
  reset_requested = false;
  systick_control_ = systick_reload_ = systick_stopped_value_ = 0;
  demcr_ = dwt_control_ = cyccnt_held_ = 0;
  scheduler_.set(id_, kNever);
}

// Reports an access to a register that the model does not have. `verb` is "read of" or "write of".
void SystemControl::unmodelled(std::uint32_t address, const char* verb) {
  diagnostics_.report(Trouble::kUnmodelled, address,
                      std::string(verb) + " " + hex(address) +
                          " in the private peripheral bus: this register is not modelled");
}

// A load from the private peripheral bus: the bytes that the instruction reads, from the register's
// word.
std::uint32_t SystemControl::read_private(std::uint32_t address, std::uint32_t size) {
  const std::uint32_t word = read_word(address & ~3U);
  if (size == 4) return word;
  return (word >> (8 * (address & 3U))) & (size == 1 ? 0xFFU : 0xFFFFU);
}

// A store to the private peripheral bus. Only the priority registers NVIC_IPR and SHPR may be
// written in bytes or halfwords; another narrow write is reported, and writes 0 to the other bytes.
void SystemControl::write_private(std::uint32_t address, std::uint32_t value, std::uint32_t size) {
  if (size == 4) return write_word(address, value);
  const std::uint32_t offset = address - scs::kBase;
  const bool bytes_allowed = (offset >= scs::kNvicIpr && offset < scs::kNvicEnd) ||
                             (offset >= scs::kShpr1 && offset < scs::kShcsr);
  if (!bytes_allowed) {
    diagnostics_.report(Trouble::kNarrow, address,
                        "write of " + std::to_string(size) + " bytes to " + hex(address));
  }
  const std::uint32_t shift = 8 * (address & 3U);
  const std::uint32_t mask = (size == 1 ? 0xFFU : 0xFFFFU) << shift;
  const std::uint32_t old = bytes_allowed ? read_word(address & ~3U) : 0U;
  write_word(address & ~3U, (old & ~mask) | ((value << shift) & mask));
}

// The value that a load of a register's word gives, and the load's side effects.
std::uint32_t SystemControl::read_word(std::uint32_t address) {
  if (address == scs::kDwtCtrl) return scs::kDwtNumComp | dwt_control_;
  if (address == scs::kDwtCyccnt) {
    const bool counts = (dwt_control_ & scs::kDwtCycCntEna) != 0 && (demcr_ & scs::kTrcEna) != 0;
    return counts ? static_cast<std::uint32_t>(cpu_.cycles() - cyccnt_start_) : cyccnt_held_;
  }
  if (address < scs::kBase || address >= scs::kEnd) {
    unmodelled(address, "read of");
    return 0;
  }
  const std::uint32_t offset = address - scs::kBase;
  if (offset >= scs::kNvicIser && offset < scs::kNvicEnd) return read_nvic(offset);
  switch (offset) {
    case scs::kIctr:
      return kInterruptLines;
    case scs::kActlr:
      return 0;
    case scs::kSystCsr: {
      catch_up_systick();
      plan_systick();
      const std::uint32_t value = systick_control_;
      systick_control_ &= ~scs::kSystCountFlag;  // reading clears it
      return value;
    }
    case scs::kSystRvr:
      return systick_reload_;
    case scs::kSystCvr:
      return systick_value();
    case scs::kSystCalib:
      return kSystickCalib;
    case scs::kCpuid:
      return kCpuId;
    case scs::kIcsr:
      return icsr();
    case scs::kVtor:
      return cpu_.vtor;
    case scs::kAircr:
      return scs::kVectKeyStat | (std::uint32_t{exceptions_.prigroup()} << scs::kPriGroupShift);
    case scs::kScr:
      return cpu_.scr;
    case scs::kCcr:
      return cpu_.ccr;
    case scs::kShpr1:
    case scs::kShpr2:
    case scs::kShpr3:
      return read_priorities(4 + (offset - 0xD18));
    case scs::kShcsr:
      return shcsr();
    case scs::kCfsr:
      return cpu_.cfsr;
    case scs::kHfsr:
      return cpu_.hfsr;
    case scs::kDfsr:
      return 0;
    case scs::kMmfar:
      return cpu_.mmfar;
    case scs::kBfar:
      return cpu_.bfar;
    case scs::kAfsr:
      return 0;
    case scs::kMpuType:
      return scs::kMpuRegions;  // none of them modelled
    case scs::kDhcsr:
      return 0;
    case scs::kDemcr:
      return demcr_;
    default:
      unmodelled(address, "read of");
      return 0;
  }
}

// Stores a whole word in a register, with the effects that the ARMv7-M manual gives the write.
void SystemControl::write_word(std::uint32_t address, std::uint32_t value) {
  if (address == scs::kDwtCtrl) {
    // The counter goes on from its value, or keeps it while it is off.
    cyccnt_held_ = read_word(scs::kDwtCyccnt);
    dwt_control_ = value & scs::kDwtCycCntEna;
    cyccnt_start_ = cpu_.cycles() - cyccnt_held_;
    if ((value & ~scs::kDwtCycCntEna & ~scs::kDwtReadOnly) != 0) unmodelled(address, "write of");
    return;
  }
  if (address == scs::kDwtCyccnt) {
    cyccnt_held_ = value;
    cyccnt_start_ = cpu_.cycles() - value;
    return;
  }
  if (address < scs::kBase || address >= scs::kEnd) return unmodelled(address, "write of");
  const std::uint32_t offset = address - scs::kBase;
  if (offset >= scs::kNvicIser && offset < scs::kNvicEnd) return write_nvic(offset, value);
  switch (offset) {
    case scs::kSystCsr: {
      catch_up_systick();
      const bool was_on = (systick_control_ & scs::kSystEnable) != 0;
      if (was_on) systick_stopped_value_ = systick_value();
      systick_control_ = (systick_control_ & scs::kSystCountFlag) |
                         (value & (scs::kSystEnable | scs::kSystTickInt | scs::kSystClkSource));
      if ((value & scs::kSystEnable) != 0) return start_systick();
      return plan_systick();
    }
    case scs::kSystRvr:
      catch_up_systick();
      systick_reload_ = value & scs::kSystCounterMask;
      return plan_systick();
    case scs::kSystCvr:
      // Any value clears the counter and COUNTFLAG.
      systick_control_ &= ~scs::kSystCountFlag;
      systick_stopped_value_ = 0;
      if ((systick_control_ & scs::kSystEnable) != 0) start_systick();
      return;
    case scs::kIcsr:
      return write_icsr(value);
    case scs::kVtor:
      cpu_.vtor = value & scs::kVtorMask;
      return;
    case scs::kAircr:
      return write_aircr(value);
    case scs::kScr:
      cpu_.scr = value & scs::kScrMask;
      exceptions_.sev_on_pend = (value & scs::kSevOnPend) != 0;
      if ((value & scs::kSleepDeep) != 0) {
        diagnostics_.report(Trouble::kUnmodelled, address,
                            "SCR.SLEEPDEEP: wait mode is not modelled");
      }
      return;
    case scs::kCcr:
      cpu_.ccr = value & scs::kCcrMask;
      return;
    case scs::kShpr1:
    case scs::kShpr2:
    case scs::kShpr3:
      return write_priorities(4 + (offset - 0xD18), value);
    case scs::kShcsr:
      return write_shcsr(value);
    case scs::kCfsr:
      cpu_.cfsr &= ~value;  // writing 1 clears a status bit, here and in HFSR
      return;
    case scs::kHfsr:
      cpu_.hfsr &= ~value;
      return;
    case scs::kMmfar:
      cpu_.mmfar = value;
      return;
    case scs::kBfar:
      cpu_.bfar = value;
      return;
    case scs::kDemcr:
      cyccnt_held_ = read_word(scs::kDwtCyccnt);
      demcr_ = value & scs::kTrcEna;
      cyccnt_start_ = cpu_.cycles() - cyccnt_held_;
      return;
    case scs::kStir:
      if ((value & scs::kStirIntId) < exc::kIrqCount) {
        exceptions_.pend(static_cast<std::uint8_t>(exc::kIrq0 + (value & scs::kStirIntId)));
      }
      return;
    default:
      return unmodelled(address, "write of");
  }
}

// -- NVIC -------------------------------------------------------------------------------------

// One word of an NVIC register: four priorities, or 32 interrupts of a bit array. Set and clear
// registers of an array read alike.
std::uint32_t SystemControl::read_nvic(std::uint32_t offset) const {
  if (offset >= scs::kNvicIpr) return read_priorities(exc::kIrq0 + (offset - scs::kNvicIpr));
  const std::uint32_t first_irq = (offset & scs::kNvicByte) * 8;
  if (first_irq >= 64) return 0;
  std::uint64_t set = 0;
  switch (offset & scs::kNvicArray) {
    case scs::kNvicIser:
    case scs::kNvicIcer:
      set = exceptions_.enabled_mask();
      break;
    case scs::kNvicIspr:
    case scs::kNvicIcpr:
      set = exceptions_.pending_mask();
      break;
    default:  // NVIC_IABR
      set = exceptions_.active_mask();
      break;
  }
  return static_cast<std::uint32_t>((set >> exc::kIrq0) >> first_irq);
}

// A write to an NVIC register: four priorities, or a bit array, in which each bit of 1 acts on its
// interrupt and bits of 0 do nothing.
void SystemControl::write_nvic(std::uint32_t offset, std::uint32_t value) {
  if (offset >= scs::kNvicIpr) {
    return write_priorities(exc::kIrq0 + (offset - scs::kNvicIpr), value);
  }
  const std::uint32_t first_irq = (offset & scs::kNvicByte) * 8;
  for (std::uint32_t bit = 0; bit < 32 && first_irq + bit < exc::kIrqCount; ++bit) {
    if (((value >> bit) & 1U) == 0) continue;
    const auto number = static_cast<std::uint8_t>(exc::kIrq0 + first_irq + bit);
    switch (offset & scs::kNvicArray) {
      case scs::kNvicIser:
        exceptions_.set_enabled(number, true);
        break;
      case scs::kNvicIcer:
        exceptions_.set_enabled(number, false);
        break;
      case scs::kNvicIspr:
        exceptions_.pend(number);
        break;
      case scs::kNvicIcpr:
        exceptions_.unpend(number);
        break;
      default:  // NVIC_IABR is read-only
        break;
    }
  }
}

// The priorities of four exceptions from number `first` on, one in each byte.
std::uint32_t SystemControl::read_priorities(std::uint32_t first) const {
  std::uint32_t value = 0;
  for (std::uint32_t i = 0; i < 4; ++i) {
    if (first + i >= exc::kCount) break;
    value |= static_cast<std::uint32_t>(exceptions_.priority(static_cast<std::uint8_t>(first + i)) &
                                        0xFF)
             << (8 * i);
  }
  return value;
}

// Sets four priorities, one from each byte, of the exceptions from number `first` on. Exceptions 7
// to 10 and 13 are reserved: nothing is written.
void SystemControl::write_priorities(std::uint32_t first, std::uint32_t value) {
  for (std::uint32_t i = 0; i < 4; ++i) {
    const std::uint32_t number = first + i;
    const bool reserved = (number >= 7 && number <= 10) || number == 13;
    if (number >= exc::kCount || reserved) continue;
    exceptions_.set_priority(static_cast<std::uint8_t>(number),
                             static_cast<std::uint8_t>(value >> (8 * i)));
  }
}

// -- SCB --------------------------------------------------------------------------------------

// ICSR as a program reads it: VECTACTIVE (the running exception), RETTOBASE (at most one exception
// is active), VECTPENDING (the most urgent exception that waits) and the pending bits.
std::uint32_t SystemControl::icsr() const {
  std::uint32_t value = cpu_.ipsr();
  const std::uint64_t active = exceptions_.active_mask();
  if ((active & (active - 1)) == 0) value |= scs::kRetToBase;
  const std::uint64_t waiting = exceptions_.pending_mask() & exceptions_.enabled_mask();
  std::uint32_t best = 0;
  int best_priority = Exceptions::kThreadPriority;
  for (std::uint64_t left = waiting; left != 0; left &= left - 1) {
    const auto number = static_cast<std::uint8_t>(__builtin_ctzll(left));
    if (exceptions_.priority(number) < best_priority) {
      best_priority = exceptions_.priority(number);
      best = number;
    }
  }
  value |= best << scs::kVectPendingShift;
  if ((waiting >> exc::kIrq0) != 0) value |= scs::kIsrPending;
  if (exceptions_.pending(exc::kSysTick)) value |= scs::kPendStSet;
  if (exceptions_.pending(exc::kPendSv)) value |= scs::kPendSvSet;
  if (exceptions_.pending(exc::kNmi)) value |= scs::kNmiPendSet;
  return value;
}

void SystemControl::write_icsr(std::uint32_t value) {
  if ((value & scs::kNmiPendSet) != 0) exceptions_.pend(exc::kNmi);
  if ((value & scs::kPendSvSet) != 0) exceptions_.pend(exc::kPendSv);
  if ((value & scs::kPendSvClr) != 0) exceptions_.unpend(exc::kPendSv);
  if ((value & scs::kPendStSet) != 0) exceptions_.pend(exc::kSysTick);
  if ((value & scs::kPendStClr) != 0) exceptions_.unpend(exc::kSysTick);
}

// AIRCR: the priority grouping, and a request to reset the chip.
void SystemControl::write_aircr(std::uint32_t value) {
  if ((value >> 16) != scs::kVectKey) {
    diagnostics_.report(Trouble::kMisuse, scs::kBase + scs::kAircr,
                        "write of AIRCR without its key 0x05FA");
    return;
  }
  exceptions_.set_prigroup(static_cast<std::uint8_t>((value >> scs::kPriGroupShift) & 7U));
  if ((value & (scs::kSysResetReq | scs::kVectReset)) != 0) {
    reset_requested = true;
    cpu_.interrupt_run();
  }
}

// SHCSR: which system exceptions are active, pending and enabled, by the bits in kHandlers.
std::uint32_t SystemControl::shcsr() const {
  std::uint32_t value = 0;
  for (const SystemHandler& handler : kHandlers) {
    if (exceptions_.active(handler.number)) value |= handler.active_bit;
    if (exceptions_.pending(handler.number)) value |= handler.pending_bit;
    if (handler.enable_bit != 0 && exceptions_.enabled(handler.number)) value |= handler.enable_bit;
  }
  return value;
}

// A write to SHCSR sets all its bits: a program can pend or unpend a system exception, and even
// change which ones count as active.
void SystemControl::write_shcsr(std::uint32_t value) {
  for (const SystemHandler& handler : kHandlers) {
    exceptions_.set_active(handler.number, (value & handler.active_bit) != 0);
    if (handler.pending_bit != 0) {
      if ((value & handler.pending_bit) != 0) {
        exceptions_.pend(handler.number);
      } else {
        exceptions_.unpend(handler.number);
      }
    }
    if (handler.enable_bit != 0) {
      exceptions_.set_enabled(handler.number, (value & handler.enable_bit) != 0);
    }
  }
}

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
