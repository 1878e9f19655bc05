// Exception entry, return, faults and their escalation (ARMv7-M B1.5.6 to B1.5.15).
//
// Stacking is one step of 12 cycles. What arrives during it takes over the handler fetch when it is
// more urgent (late arrival); what pends at a return is entered without unstacking (tail-chaining).
#include <algorithm>

#include "cpu/cpu.hpp"

namespace due_emulator {

namespace {

constexpr std::uint32_t kEntryCycles = 12;
constexpr std::uint32_t kReturnCycles = 10;
constexpr std::uint32_t kTailChainCycles = 6;

// EXC_RETURN: LR in a handler says where to return to: a handler, or a thread on the main or on the
// process stack.
constexpr std::uint32_t kReturnHandler = 0xFFFFFFF1U;
constexpr std::uint32_t kReturnThreadMain = 0xFFFFFFF9U;
constexpr std::uint32_t kReturnThreadProcess = 0xFFFFFFFDU;

constexpr std::uint32_t kHfsrVectorTable = 1U << 1;
constexpr std::uint32_t kHfsrForced = 1U << 30;
constexpr std::uint32_t kHfsrDebugEvent = 1U << 31;

constexpr std::uint32_t kCcrNonBaseThread = 1U << 0;
constexpr std::uint32_t kCcrStackAlign = 1U << 9;
constexpr std::uint32_t kScrSleepOnExit = 1U << 1;

// An exception pushes 8 words: r0 to r3, r12, LR, return address, xPSR. Bit 9 of that xPSR notes
// that one more word aligns the stack to 8 bytes.
constexpr std::uint32_t kFrameBytes = 0x20;
constexpr std::uint32_t kPsrPadded = 1U << 9;
constexpr std::uint32_t kPsrThumb = 1U << 24;
constexpr std::uint32_t kPsrIpsr = 0x1FF;

}  // namespace

// Makes r13 the process or the main stack pointer; the other one is in other_sp_.
void Cpu::use_psp(bool psp) {
  if (psp == uses_psp_) return;
  std::swap(r[kSp], other_sp_);
  uses_psp_ = psp;
}

// Lockup (B1.5.15): a fault that no handler can take. In strict mode the simulation stops.
void Cpu::lock_up(const std::string& why) {
  if (!bus_.diagnostics().strict(Trouble::kLockup)) {
    // On the chip the peripherals go on, and only a reset ends it: the watchdog's, for example.
    hold(true);
    return;
  }
  halt_ = Halt::kLockup;
  const std::uint32_t at = pc();
  std::string message = "lockup: " + why + "; at pc " + hex(at);
  const std::string function = bus_.diagnostics().symbols.describe(at);
  if (!function.empty()) message += " in " + function;
  throw Stop(message);
}

// Notes the fault in its status registers and pends its exception, or HardFault if that one cannot
// be taken now. Locks up if not even HardFault can; `synchronous`: the running instruction caused
// the fault.
void Cpu::raise(const Fault& fault, bool synchronous) {
  cfsr |= fault.cfsr;
  if (fault.has_address && fault.exception == exc::kBusFault) {
    bfar = fault.address;
    cfsr |= cfsr::kBfarValid;
  }
  if (fault.has_address && fault.exception == exc::kMemManage) {
    mmfar = fault.address;
    cfsr |= cfsr::kMmarValid;
  }
  std::uint8_t number = fault.exception;
  if (number != exc::kHardFault && !exceptions_.can_take(number)) {
    number = exc::kHardFault;
    hfsr |= kHfsrForced;
  }
  if (number == exc::kHardFault && !exceptions_.can_take(exc::kHardFault) && synchronous) {
    lock_up("fault inside a handler of priority -1 or above, CFSR " + hex(cfsr) + ", HFSR " +
            hex(hfsr));
  }
  exceptions_.pend(number);
}

// Pushes the frame of the interrupted code. A fault during the push pends its exception, and the
// entry goes on.
void Cpu::push_frame() {
  const bool align = (ccr & kCcrStackAlign) != 0;
  const std::uint32_t padding = align && (r[kSp] & 4U) != 0 ? 4U : 0U;
  const std::uint32_t frame = r[kSp] - kFrameBytes - padding;
  const std::uint32_t return_address = pc();
  const std::uint32_t saved_psr = xpsr() | (padding != 0 ? kPsrPadded : 0U);
  r[kSp] = frame;
  try {
    const std::uint32_t words[8] = {r[0],  r[1],   r[2],           r[3],
                                    r[12], r[kLr], return_address, saved_psr};
    for (unsigned i = 0; i < 8; ++i) store<std::uint32_t>(frame + 4 * i, words[i]);
  } catch (const Fault& fault) {
    const bool bus = fault.exception == exc::kBusFault;
    raise({fault.exception, bus ? cfsr::kStkErr : cfsr::kMstkErr}, kAsynchronous);
  }
}

// Exception entry from the running code: stacking, then the handler that is most urgent at its end.
void Cpu::enter_exception() {
  if (stop_at_hardfault && exceptions_.next() == exc::kHardFault) {
    halt_ = Halt::kHardFault;
    return;
  }
  const std::uint32_t exc_return =
      ipsr_ != 0 ? kReturnHandler : (uses_psp_ ? kReturnThreadProcess : kReturnThreadMain);
  push_frame();
  cycles_ += kEntryCycles;
  if (cycles_ >= scheduler_.next()) scheduler_.dispatch(cycles_);
  enter_handler(exc_return);
}

// Starts the handler of the most urgent pending exception; the frame is already on the stack.
// `exc_return` is its LR. If the vector cannot be read, HardFault pends instead.
void Cpu::enter_handler(std::uint32_t exc_return) {
  const std::uint8_t number = exceptions_.next();
  if (stop_at_hardfault && number == exc::kHardFault) {
    halt_ = Halt::kHardFault;
    return;
  }
  use_psp(false);
  ipsr_ = number;
  r[kLr] = exc_return;
  exceptions_.activate(number);
  exclusive = false;
  exceptions_.event = true;
  note_entry(number);
  std::uint32_t vector = 0;
  try {
    vector = slow_load(vtor + 4U * number, 4);
  } catch (const Fault&) {
    if (number <= exc::kHardFault) lock_up("the vector of the fault handler cannot be read");
    hfsr |= kHfsrVectorTable;
    exceptions_.pend(exc::kHardFault);
    ip_ = bad_slot(0);
    return;
  }
  thumb_ = (vector & 1U) != 0;
  ip_ = thumb_ ? slot(vector & ~1U) : bad_slot(vector & ~1U);
}

// A return that EXC_RETURN or the active exceptions do not allow: UsageFault INVPC.
void Cpu::fail_return(std::uint32_t exc_return) {
  note_return();
  if (exceptions_.active(static_cast<std::uint8_t>(ipsr_))) {
    exceptions_.deactivate(static_cast<std::uint8_t>(ipsr_));
  }
  r[kLr] = 0xF0000000U | exc_return;
  raise({exc::kUsageFault, cfsr::kInvPc}, kSynchronous);
  // The frame of the interrupted code is still on the stack: enter without another one.
  enter_handler(r[kLr]);
}

// Exception return (B1.5.8): checks EXC_RETURN, ends the exception, and continues with the next
// pending one (tail-chaining) or with the interrupted code. Returns the next instruction.
const Insn* Cpu::return_from_exception(std::uint32_t exc_return) {
  const auto number = static_cast<std::uint8_t>(ipsr_);
  // Active exceptions. The last one may return to thread mode only, unless NONBASETHRDENA allows
  // it.
  const int nesting = __builtin_popcountll(exceptions_.active_mask());
  const bool base_only = (ccr & kCcrNonBaseThread) == 0 && nesting != 1;
  const bool to_handler = exc_return == kReturnHandler;
  const bool to_thread = exc_return == kReturnThreadMain || exc_return == kReturnThreadProcess;
  stop_at_ = 0;  // ends the burst: another exception may be urgent enough now
  if (!exceptions_.active(number) || (!to_handler && !to_thread) || (to_handler && nesting == 1) ||
      (to_thread && base_only)) {
    fail_return(exc_return);
    return ip_;
  }
  if (number != exc::kNmi) exceptions_.set_faultmask(false);
  note_return();
  exceptions_.deactivate(number);
  exceptions_.event = true;
  exclusive = false;
  if (exceptions_.next() != 0) {
    cycles_ += kTailChainCycles;
    ip_ = bad_slot(exc_return);
    enter_handler(exc_return);
    return ip_;
  }
  pop_frame(exc_return);
  return ip_;
}

// Pops the frame and continues the interrupted code. A fault during that, or a frame whose IPSR
// does not fit `exc_return`, enters the fault's handler on the same frame.
void Cpu::pop_frame(std::uint32_t exc_return) {
  cycles_ += kReturnCycles;
  const bool process = exc_return == kReturnThreadProcess;
  if (exc_return != kReturnHandler) spsel_ = process;
  use_psp(process);
  const std::uint32_t frame = r[kSp];
  std::uint32_t words[8] = {};
  try {
    for (unsigned i = 0; i < 8; ++i) words[i] = load<std::uint32_t>(frame + 4 * i);
  } catch (const Fault& fault) {
    const bool bus = fault.exception == exc::kBusFault;
    ip_ = bad_slot(exc_return);
    use_psp(false);
    raise({fault.exception, bus ? cfsr::kUnstkErr : cfsr::kMunstkErr}, kSynchronous);
    enter_handler(exc_return);
    return;
  }
  const std::uint32_t psr = words[7];
  const bool padded = (ccr & kCcrStackAlign) != 0 && (psr & kPsrPadded) != 0;
  const std::uint32_t new_ipsr = psr & kPsrIpsr;
  if ((exc_return == kReturnHandler) != (new_ipsr != 0)) {
    use_psp(false);
    r[kLr] = 0xF0000000U | exc_return;
    ip_ = bad_slot(exc_return);
    raise({exc::kUsageFault, cfsr::kInvPc}, kSynchronous);
    enter_handler(r[kLr]);
    return;
  }
  std::copy_n(words, 4, r);
  r[12] = words[4];
  r[kLr] = words[5];
  r[kSp] = frame + kFrameBytes + (padded ? 4U : 0U);
  ipsr_ = new_ipsr;
  set_apsr(psr);
  thumb_ = (psr & kPsrThumb) != 0;
  const std::uint32_t target = words[6] & ~1U;
  // ITSTATE: bits 26 and 25, and 15 to 10.
  const auto it = static_cast<std::uint8_t>(((psr >> 25) & 3U) | ((psr >> 8) & 0xFCU));
  ip_ = thumb_ ? slot(target) : bad_slot(target);
  if (ip_ != &bad_slot_ && ip_->it != it) resume_at(target, it);
  if (ipsr_ == 0 && (scr & kScrSleepOnExit) != 0) sleeping_ = true;
}

// SVC: the exception is taken before the next instruction; if it cannot be, it is a fault.
const Insn* Cpu::supervisor_call(const Insn* insn) {
  if (!exceptions_.can_take(exc::kSvCall)) throw Fault{exc::kSvCall, 0};
  exceptions_.pend(exc::kSvCall);
  return insn + insn->length;
}

// BKPT.
const Insn* Cpu::breakpoint_instruction(const Insn*) {
  // No debugger is attached to the core, so the event becomes a HardFault.
  hfsr |= kHfsrDebugEvent;
  throw Fault{exc::kHardFault, 0};
}

// WFI: sleeps until an exception pends that could preempt.
const Insn* Cpu::wait_for_interrupt(const Insn* insn) {
  sleeping_ = !exceptions_.wakes();
  waiting_for_event_ = false;
  stop_at_ = 0;
  return insn + insn->length;
}

// WFE: takes an event that has happened, or sleeps until the next one.
const Insn* Cpu::wait_for_event(const Insn* insn) {
  if (std::exchange(exceptions_.event, false)) return insn + insn->length;
  sleeping_ = waiting_for_event_ = true;
  stop_at_ = 0;
  return insn + insn->length;
}

namespace {

// SYSm: numbers of the special registers in MRS and MSR.
enum Sysm : unsigned {
  kMsp = 8,
  kPsp = 9,
  kPrimask = 16,
  kBasepri = 17,
  kBasepriMax = 18,
  kFaultmask = 19,
  kControl = 20
};

}  // namespace

// -- special registers ------------------------------------------------------------------------

// CPSID and CPSIE. FAULTMASK can be set only at a priority above HardFault's, which is -1.
void Cpu::change_processor_state(bool disable, bool primask, bool faultmask) {
  if (!privileged()) return;
  if (primask) exceptions_.set_primask(disable);
  if (faultmask && (!disable || exceptions_.execution_priority() > -1)) {
    exceptions_.set_faultmask(disable);
  }
}

// MRS. `sysm` is the number of a special register in the manual's table (B5.1.1); an unprivileged
// program reads most of them as 0.
std::uint32_t Cpu::read_special(unsigned sysm) const {
  if (sysm <= 7) {  // combinations of APSR, IPSR and EPSR
    std::uint32_t value = 0;
    if ((sysm & 1U) != 0) value |= ipsr_;
    if ((sysm & 4U) == 0) value |= xpsr() & 0xF8000000U;
    return value;  // EPSR reads as zero
  }
  if (sysm == kControl) return control();
  if (!privileged()) return 0;
  switch (sysm) {
    case kMsp:
      return msp();
    case kPsp:
      return psp();
    case kPrimask:
      return exceptions_.primask() ? 1U : 0U;
    case kBasepri:
    case kBasepriMax:
      return exceptions_.basepri();
    case kFaultmask:
      return exceptions_.faultmask() ? 1U : 0U;
    default:
      return 0;
  }
}

// MSR. Bit 3 of `mask` writes the flags of APSR.
void Cpu::write_special(unsigned sysm, std::uint32_t value, unsigned mask) {
  // APSR and its combinations with IPSR and EPSR, of which only the flags can be written.
  if (sysm < 4) {
    if ((mask & 8U) != 0) set_apsr(value);  // bit 3 of the mask: N, Z, C, V, Q
    return;
  }
  if (!privileged()) return;
  switch (sysm) {
    case kMsp:
      (uses_psp_ ? other_sp_ : r[kSp]) = value & ~3U;
      break;
    case kPsp:
      (uses_psp_ ? r[kSp] : other_sp_) = value & ~3U;
      break;
    case kPrimask:
      exceptions_.set_primask((value & 1U) != 0);
      break;
    case kBasepri:
      exceptions_.set_basepri(static_cast<std::uint8_t>(value));
      break;
    case kBasepriMax: {  // only raises the urgency
      const auto base = static_cast<std::uint8_t>(value & 0xF0U);
      if (base != 0 && (exceptions_.basepri() == 0 || base < exceptions_.basepri())) {
        exceptions_.set_basepri(base);
      }
      break;
    }
    case kFaultmask:
      if ((value & 1U) == 0 || exceptions_.execution_priority() > -1) {
        exceptions_.set_faultmask((value & 1U) != 0);
      }
      break;
    case kControl:
      unprivileged_thread_ = (value & 1U) != 0;  // nPRIV
      if (ipsr_ == 0) {
        spsel_ = (value & 2U) != 0;  // SPSEL
        use_psp(spsel_);
      }
      break;
    default:
      break;
  }
}

}  // namespace due_emulator
