// The processor's run loop, registers, memory accesses and breakpoints; see cpu.hpp.
#include "cpu/cpu.hpp"

#include <algorithm>

#include "cpu/decoder.hpp"

namespace due_emulator {

namespace {

// Handler of a slot that is not decoded yet.
const Insn* decode_slot(Cpu& cpu, const Insn* insn) { return cpu.decode(insn); }
// Handler of the slot behind the end of a memory.
const Insn* fetch_fails(Cpu& cpu, const Insn*) { return cpu.bad_fetch(); }

// What an empty slot of a code window holds: running it decodes the instruction.
Insn blank() {
  Insn insn{};
  insn.run = &decode_slot;
  insn.length = 1;
  return insn;
}

// What the slot behind a window's end holds.
Insn past_end() {
  Insn insn{};
  insn.run = &fetch_fails;
  return insn;
}

constexpr std::uint32_t kUnalignTrap = 1U << 3;  // CCR.UNALIGN_TRP

std::uint32_t pc_of_cpu(const void* cpu) { return static_cast<const Cpu*>(cpu)->pc(); }

}  // namespace

// Opens the decoded copy of the flash, and has scheduler, exceptions and diagnostics reach the
// processor.
Cpu::Cpu(Memory& memory, Bus& bus, Scheduler& scheduler, Exceptions& exceptions)
    : memory_(memory),
      bus_(bus),
      scheduler_(scheduler),
      exceptions_(exceptions),
      ram_(memory.ram.data()),
      bad_slot_(past_end()) {
  ip_ = &bad_slot_;
  memory_.windows[Memory::kFlash].open(blank(), past_end());
  flash_slots_ = memory_.windows[Memory::kFlash].slots();
  scheduler_.watch(&stop_at_);
  exceptions_.watch(&stop_at_);
  bus_.diagnostics().pc_of = &pc_of_cpu;
  bus_.diagnostics().pc_source = this;
}

// Reset (B1.5.5): thread mode on the main stack, flags and faults cleared; decoded code is
// forgotten.
void Cpu::reset() {
  std::fill(std::begin(r), std::end(r), 0U);
  r[kLr] = ~0U;
  other_sp_ = 0;
  spsel_ = uses_psp_ = unprivileged_thread_ = false;
  ipsr_ = 0;
  // No flag is set: N and V are bit 31 of their source, Z means that its source is 0.
  n_src = 0;
  z_src = 1;
  carry = v_src = q_flag = 0;
  exclusive = false;
  sleeping_ = waiting_for_event_ = false;
  halt_ = Halt::kNone;
  cfsr = hfsr = mmfar = bfar = scr = vtor = 0;
  ccr = 0x200;  // STKALIGN
  open_exceptions_.clear();
  open_probes_.clear();
  flush_ = false;
  memory_.forget_flash_code();
  memory_.windows[Memory::kSram].forget_all();
  memory_.windows[Memory::kSram0].forget_all();
  ip_ = bad_slot(0);
  // The vector table: the stack pointer, then the address of the reset handler, with bit 0 for
  // Thumb.
  set_sp(slow_load(vtor, 4));
  const std::uint32_t start = slow_load(vtor + 4, 4);
  thumb_ = (start & 1U) != 0;
  ip_ = thumb_ ? slot(start & ~1U) : bad_slot(start & ~1U);
}

// -- running ----------------------------------------------------------------------------------

// Runs the events that are due, lets time pass if the processor is held in reset or asleep, and
// enters a pending exception. Returns false if no instruction may run now.
bool Cpu::prepare(std::uint64_t until) {
  if (cycles_ >= scheduler_.next()) scheduler_.dispatch(cycles_);
  if (flush_) forget_flash_code();
  if (leave_) return false;
  if (held_) {
    const std::uint64_t wake = std::min(until, scheduler_.next());
    cycles_ = std::max(cycles_, wake);
    return false;
  }
  if (sleeping_) {
    const bool event = waiting_for_event_ && std::exchange(exceptions_.event, false);
    if (!event && !exceptions_.wakes()) {
      const std::uint64_t wake = std::max(cycles_, std::min(until, scheduler_.next()));
      sleep_cycles_ += wake - cycles_;
      cycles_ = wake;
      return false;
    }
    sleeping_ = false;
  }
  if (exceptions_.next() != 0) enter_exception();
  return halt_ == Halt::kNone && cycles_ < until;
}

// The hot loop: executes instructions until stop_at_. The program counter is in a local variable;
// ip_ is up to date while an instruction runs.
void Cpu::burst() {
  const Insn* ip = ip_;
  while (cycles_ < stop_at_) {
    cycles_ += ip->cycles;
    ++instructions_;
    ip_ = ip;
    ip = ip->run(*this, ip);
  }
  ip_ = ip;
}

// Alternates between prepare() and burst(). A Fault thrown by an instruction becomes an exception.
void Cpu::run(std::uint64_t until) {
  leave_ = false;
  while (cycles_ < until && halt_ == Halt::kNone && !leave_) {
    if (!prepare(until)) continue;
    stop_at_ = std::min(until, scheduler_.next());
    if (exceptions_.next() != 0) continue;
    try {
      burst();
    } catch (const Fault& fault) {
      raise(fault, kSynchronous);
    }
  }
}

// As one round of run(), with one instruction in place of a burst.
void Cpu::step(std::uint64_t until) {
  leave_ = false;
  if (halt_ != Halt::kNone || !prepare(until)) return;
  stop_at_ = kNever;  // unless the instruction itself changes it
  try {
    const Insn* ip = ip_;
    cycles_ += ip->cycles;
    ++instructions_;
    ip_ = ip->run(*this, ip);
  } catch (const Fault& fault) {
    raise(fault, kSynchronous);
  }
}

// -- decoded code -----------------------------------------------------------------------------

// Handler of a slot that is run for the first time: decodes and executes its instruction. The slot
// had cost no cycles yet.
const Insn* Cpu::decode(const Insn* at) {
  const std::uint32_t address = pc_of(at);
  resume_at(address, 0);
  CodeWindow& window = *memory_.window_of(at);
  const Insn* insn = window.slot(address);
  cycles_ += insn->cycles;
  return insn->run(*this, insn);
}

// Decodes the instruction at `address` with the ITSTATE `it` in front of it, and the whole IT block
// that it stands in or opens: only the block's first instruction knows the others' conditions.
void Cpu::resume_at(std::uint32_t address, std::uint8_t it) {
  CodeWindow* window = memory_.window_of(address);
  if (window == nullptr) return;
  const bool in_ram = window->bytes() == memory_.ram.data();
  do {
    const Decoder decoder(*this, *window, address, it);
    Insn& slot = *window->slot(address);
    slot = decoder.insn();
    window->note_decoded(address);
    if (in_ram) {
      const std::uint32_t offset = address - window->base();
      // Writes to these blocks of 64 bytes must forget the copy.
      memory_.ram_code[offset / 64] = 1;
      memory_.ram_code[std::min(offset + 3, kRamSize - 1) / 64] = 1;
    }
    const auto mark = marks_.find(address);
    if (mark != marks_.end()) {
      mark->second.original = slot.run;
      slot.run = [](Cpu& cpu, const Insn* i) { return cpu.marked(i); };
    }
    // ITAdvance() of the manual (A7.3): the lower five bits shift left, and 000 ends the block.
    it = decoder.is_it()    ? decoder.opens_it()
         : (it & 0x7U) == 0 ? std::uint8_t{0}
                            : static_cast<std::uint8_t>((it & 0xE0U) | ((it << 1) & 0x1FU));
    address += 2U * slot.length;
  } while (it != 0 && window->holds(address));
}

// Empties the decoded copies of the flash. An IT block that is being executed is decoded again,
// because its conditions are known only in the copy.
void Cpu::forget_flash_code() {
  flush_ = false;
  // The first two windows are those of the flash.
  const bool in_flash = memory_.windows[Memory::kFlash].holds(ip_) ||
                        memory_.windows[Memory::kFlashMirror].holds(ip_);
  const std::uint32_t address = pc();
  const std::uint8_t it_state = ip_->it;
  memory_.forget_flash_code();
  if (in_flash && it_state != 0) resume_at(address, it_state);
}

void Cpu::set_flash_wait_states(std::uint32_t count) {
  if (count == flash_wait_states_) return;
  flash_wait_states_ = count;
  flush_flash_code();
}

// The address of a decoded instruction; of the bad slot, the address that was branched to.
std::uint32_t Cpu::pc_of(const Insn* insn) const {
  for (const CodeWindow& window : memory_.windows) {
    if (window.holds(insn)) return window.address_of(insn);
  }
  return bad_pc_;
}

// The instruction that stands for an address where nothing can be executed: running it faults.
const Insn* Cpu::bad_slot(std::uint32_t address) {
  bad_pc_ = address;
  return &bad_slot_;
}

// The decoded instruction at any address; slot() has the fast way for flash. Opens the copy of a
// memory at its first use.
const Insn* Cpu::slow_slot(std::uint32_t address) {
  CodeWindow* window = memory_.window_of(address);
  if (window == nullptr) return bad_slot(address);
  if (window->bytes() == memory_.flash.data()) bus_.use_flash(address - window->base());
  if (window->slots() == nullptr) window->open(blank(), past_end());
  return window->slot(address);
}

// Handler of an instruction that cannot be fetched: raises the fault that the chip raises.
const Insn* Cpu::bad_fetch() {
  const std::uint32_t address = pc();
  if (!thumb_) throw Fault{exc::kUsageFault, cfsr::kInvState};
  bus_.diagnostics().report(
      Trouble::kUnmapped, address,
      "instruction fetch from " + hex(address) + ", where there is no memory");
  // Regions of 512 MB in the default memory map (B3.1): peripherals (2), devices and system (from
  // 5) are execute-never.
  const std::uint32_t region = address >> 29;
  const bool never_executable = region == 2 || region >= 5;
  if (never_executable) throw Fault{exc::kMemManage, cfsr::kIaccViol};
  throw Fault{exc::kBusFault, cfsr::kIbusErr};
}

// BXWritePC and LoadWritePC. A target without bit 0 would be ARM code: the next fetch faults.
const Insn* Cpu::branch_exchange(std::uint32_t target) {
  // From 0xF0000000 on it is an EXC_RETURN, in handler mode.
  if (target >= 0xF0000000U && ipsr_ != 0) return return_from_exception(target);
  if ((target & 1U) != 0) return slot(target & ~1U);
  thumb_ = false;
  return bad_slot(target);
}

// -- memory -----------------------------------------------------------------------------------

// Any load that is not an aligned one from SRAM: flash directly, everything else by the bus.
std::uint32_t Cpu::slow_load(std::uint32_t address, std::uint32_t size) {
  const std::uint32_t offset = address - kFlashBase;
  if (offset < kFlashSize && (address & (size - 1)) == 0 && !flash_busy) {
    std::uint32_t value = 0;
    std::memcpy(&value, memory_.flash.data() + offset, size);
    return value;
  }
  if ((address & (size - 1)) != 0 && (ccr & kUnalignTrap) != 0) throw_unaligned(address);
  return bus_.read(address, size);
}

void Cpu::slow_store(std::uint32_t address, std::uint32_t value, std::uint32_t size) {
  if ((address & (size - 1)) != 0 && (ccr & kUnalignTrap) != 0) throw_unaligned(address);
  bus_.write(address, value, size);
}

// UsageFault UNALIGNED, for accesses that the processor cannot split.
void Cpu::throw_unaligned(std::uint32_t address) const {
  bus_.diagnostics().report(Trouble::kUnaligned, address,
                            "access to " + hex(address) + ", which this instruction cannot split");
  throw Fault{exc::kUsageFault, cfsr::kUnaligned};
}

void Cpu::undefined(const Insn*) const { throw Fault{exc::kUsageFault, cfsr::kUndefInstr}; }

// -- registers --------------------------------------------------------------------------------

void Cpu::set_pc(std::uint32_t address) {
  thumb_ = true;
  ip_ = slot(address & ~1U);
}

// For a debugger: r0 to r15.
void Cpu::set_reg(unsigned index, std::uint32_t value) {
  if (index == kPc) return set_pc(value);
  if (index == kSp) return set_sp(value);
  r[index] = value;
}

// xPSR: N, Z, C, V, Q in bits 31 to 27, ITSTATE in 26 to 25 and 15 to 10, T in 24, IPSR below.
std::uint32_t Cpu::xpsr() const {
  const std::uint32_t it = ip_->it;
  return (n_src & 0x80000000U) | (z_src == 0 ? 1U << 30 : 0U) | (carry << 29) |
         ((v_src >> 31) << 28) | (q_flag << 27) | ((it & 3U) << 25) | ((it >> 2) << 10) |
         (thumb_ ? 1U << 24 : 0U) | ipsr_;
}

// Takes N, Z, C, V and Q from bits 31 to 27, in the form in which cpu.hpp keeps the flags.
void Cpu::set_apsr(std::uint32_t value) {
  n_src = value & 0x80000000U;
  z_src = (value & 0x40000000U) != 0 ? 0 : 1;
  carry = (value >> 29) & 1U;
  v_src = value << 3;
  q_flag = (value >> 27) & 1U;
}

// ConditionPassed (A7.3): bits 3 to 1 choose the test, bit 0 inverts it.
bool Cpu::passes(unsigned condition) const {
  const bool n = (n_src >> 31) != 0;
  const bool z = z_src == 0;
  const bool v = (v_src >> 31) != 0;
  bool result = true;
  switch (condition >> 1) {
    case 0:  // EQ, NE
      result = z;
      break;
    case 1:  // CS, CC
      result = carry != 0;
      break;
    case 2:  // MI, PL
      result = n;
      break;
    case 3:  // VS, VC
      result = v;
      break;
    case 4:  // HI, LS
      result = carry != 0 && !z;
      break;
    case 5:  // GE, LT
      result = n == v;
      break;
    case 6:  // GT, LE
      result = n == v && !z;
      break;
    default:  // AL
      return true;
  }
  return result == ((condition & 1U) == 0);
}

}  // namespace due_emulator
