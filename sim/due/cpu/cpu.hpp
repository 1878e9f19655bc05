// The Cortex-M3 r2p0 of the SAM3X: registers, the run loop, exception entry and return.
//
// Members that the instruction handlers (ops_*.hpp) touch are public; nothing outside of cpu/ uses
// them except through the functions in the first half.
#pragma once

#include <algorithm>
#include <array>
#include <cstdint>
#include <cstring>
#include <map>
#include <set>
#include <string>
#include <vector>

#include "bus/bus.hpp"
#include "bus/memory.hpp"
#include "bus/scheduler.hpp"
#include "cpu/exceptions.hpp"
#include "cpu/insn.hpp"

namespace due_emulator {

// How often an exception was taken and what its handler cost, time in nested handlers excluded.
struct ExceptionStats {
  std::uint64_t count = 0;
  std::uint64_t instructions = 0;
  std::uint64_t max_instructions = 0;
  std::uint64_t max_cycles = 0;
  std::uint64_t last_entry = 0;  // cycle
};

// The same for one function, from its first instruction to its return, interrupts excluded.
struct ProbeStats {
  std::uint64_t count = 0;
  std::uint64_t instructions = 0;
  std::uint64_t max_instructions = 0;
  std::uint64_t last_instructions = 0;
};

enum class Halt : std::uint8_t {
  kNone,
  kBreakpoint,  // a breakpoint set through add_breakpoint()
  kHardFault,   // a HardFault was about to be entered and stop_at_hardfault is set
  kLockup,      // a fault at the priority of HardFault or above
};

class Cpu {
 public:
  Cpu(Memory& memory, Bus& bus, Scheduler& scheduler, Exceptions& exceptions);

  // Registers as after reset; stack pointer and program counter from the vector table.
  void reset();
  // Runs until the cycle counter reaches `until` or something halts.
  void run(std::uint64_t until);
  // One instruction, or one exception entry, or one sleep to the next event before `until`.
  void step(std::uint64_t until);
  // Adds cycles that the processor spends waiting for the bus.
  void stall(std::uint64_t cycles) { cycles_ += cycles; }

  std::uint64_t cycles() const { return cycles_; }
  std::uint64_t instructions() const { return instructions_; }
  std::uint64_t sleep_cycles() const { return sleep_cycles_; }
  bool sleeping() const { return sleeping_; }
  Halt halt() const { return halt_; }
  void clear_halt() { halt_ = Halt::kNone; }
  bool stop_at_hardfault = false;
  // Makes run() return before the next instruction, as after a change of clock.
  void interrupt_run() {
    leave_ = true;
    stop_at_ = 0;
  }
  // The reset line: no instruction runs, peripheral models and time go on.
  void hold(bool held) {
    held_ = held;
    stop_at_ = 0;
  }
  bool held() const { return held_; }

  std::uint32_t pc() const { return pc_of(ip_); }
  void set_pc(std::uint32_t address);
  std::uint32_t xpsr() const;
  void set_apsr(std::uint32_t value);
  std::uint32_t reg(unsigned index) const { return index == kPc ? pc() : r[index]; }
  void set_reg(unsigned index, std::uint32_t value);
  std::uint32_t msp() const { return uses_psp_ ? other_sp_ : r[kSp]; }
  std::uint32_t psp() const { return uses_psp_ ? r[kSp] : other_sp_; }
  std::uint32_t control() const { return (spsel_ ? 2U : 0U) | (unprivileged_thread_ ? 1U : 0U); }
  std::uint32_t ipsr() const { return ipsr_; }
  // Whether the next instruction is in an IT block and its condition fails.
  bool next_is_skipped() const {
    return ip_->it != 0 && !passes(static_cast<unsigned>(ip_->it) >> 4);
  }
  bool privileged() const { return ipsr_ != 0 || !unprivileged_thread_; }

  void add_breakpoint(std::uint32_t address);
  void remove_breakpoint(std::uint32_t address);
  void add_probe(std::uint32_t address);
  ProbeStats probe(std::uint32_t address) const;
  const ExceptionStats& stats(std::uint8_t number) const { return stats_[number]; }
  void clear_stats();

  // Number of handlers that run, nested in each other; the instructions of the innermost one (of
  // the thread if there is none), without those that interrupted it; and the instruction count at
  // its entry, which distinguishes its runs.
  std::size_t nesting() const { return open_exceptions_.size(); }
  std::uint64_t instructions_of_level() const {
    return instructions_ - nested_[std::min(nesting(), nested_.size() - 1)];
  }
  std::uint64_t entry_of_level() const {
    return open_exceptions_.empty() ? 0 : open_exceptions_.back().instructions;
  }
  // For a program that polls a peripheral: the next instruction is the load that reads `value` in a
  // loop with no other access to a peripheral. Returns the bits of the value each of which, if it
  // changed alone, would make the program leave the loop.
  std::uint32_t deciding_bits(std::uint32_t value);

  // Fault status registers of the SCB, kept here because the processor writes them.
  std::uint32_t cfsr = 0;
  std::uint32_t hfsr = 0;
  std::uint32_t mmfar = 0;
  std::uint32_t bfar = 0;
  std::uint32_t ccr = 0x200;
  std::uint32_t scr = 0;
  std::uint32_t vtor = 0;

  // Decoded code became stale: flash was programmed or its wait states changed.
  // Takes effect before the next instruction: the running one still reads its own slot.
  void flush_flash_code() {
    flush_ = true;
    stop_at_ = 0;
  }
  void set_flash_wait_states(std::uint32_t count);
  std::uint32_t flash_wait_states() const { return flash_wait_states_; }
  // Set by the flash controllers while a plane is busy; reads of it then go the long way.
  bool flash_busy = false;

  // -- for the instruction handlers -----------------------------------------------------------

  std::uint32_t r[16] = {};
  // Flags, kept as the values that they follow from: N = n_src < 0, Z = z_src == 0.
  std::uint32_t n_src = 0;
  std::uint32_t z_src = 1;
  std::uint32_t carry = 0;
  std::uint32_t v_src = 0;  // bit 31
  std::uint32_t q_flag = 0;
  bool exclusive = false;
  std::uint32_t exclusive_address = 0;

  bool passes(unsigned condition) const;
  // The decoded instruction at an address; flash is the fast way.
  const Insn* slot(std::uint32_t address) {
    const std::uint32_t offset = address - kFlashBase;
    if (offset < kFlashSize && flash_slots_ != nullptr) return flash_slots_ + (offset >> 1);
    return slow_slot(address);
  }
  // A branch that chooses the instruction set by bit 0, or returns from an exception.
  const Insn* branch_exchange(std::uint32_t target);
  std::uint32_t pc_of(const Insn* insn) const;

  // A load of a T (1, 2 or 4 bytes): aligned SRAM directly, everything else the slow way.
  template <typename T>
  std::uint32_t load(std::uint32_t address) {
    const std::uint32_t offset = address - kRamBase;
    if (offset < kRamSize && (address & (sizeof(T) - 1)) == 0) {
      T value;
      std::memcpy(&value, ram_ + offset, sizeof value);
      return value;
    }
    return slow_load(address, sizeof(T));
  }
  // A store likewise; code that was decoded from there is forgotten.
  template <typename T>
  void store(std::uint32_t address, std::uint32_t value) {
    const std::uint32_t offset = address - kRamBase;
    if (offset < kRamSize && (address & (sizeof(T) - 1)) == 0) {
      const T narrow = static_cast<T>(value);
      std::memcpy(ram_ + offset, &narrow, sizeof narrow);
      if (memory_.ram_code[offset / 64] != 0) memory_.forget_ram_code(offset, sizeof(T));
      return;
    }
    slow_store(address, value, sizeof(T));
  }
  // The host's address of `bytes` bytes of SRAM (at most 64, from a multiple of 4 on), or null if
  // they are not all in SRAM. The second is for writes: null too if they may change decoded code.
  const std::uint8_t* ram_at(std::uint32_t address, std::uint32_t bytes) const {
    const std::uint32_t offset = address - kRamBase;
    return offset <= kRamSize - bytes ? ram_ + offset : nullptr;
  }
  std::uint8_t* ram_without_code(std::uint32_t address, std::uint32_t bytes) {
    const std::uint32_t offset = address - kRamBase;
    if (offset > kRamSize - bytes) return nullptr;
    const bool code =
        memory_.ram_code[offset / 64] != 0 || memory_.ram_code[(offset + bytes - 1) / 64] != 0;
    return code ? nullptr : ram_ + offset;
  }
  // For LDM, LDRD and exclusives, which fault on any address that is not a multiple of 4.
  void require_aligned(std::uint32_t address, std::uint32_t size) const {
    if ((address & (size - 1)) != 0) throw_unaligned(address);
  }

  // Handlers, and what they call; each returns the next instruction.
  const Insn* decode(const Insn* at);
  const Insn* bad_fetch();
  const Insn* supervisor_call(const Insn* insn);
  const Insn* breakpoint_instruction(const Insn* insn);
  const Insn* wait_for_interrupt(const Insn* insn);
  const Insn* wait_for_event(const Insn* insn);
  const Insn* marked(const Insn* insn);
  std::uint32_t read_special(unsigned sysm) const;
  void write_special(unsigned sysm, std::uint32_t value, unsigned mask);
  void change_processor_state(bool disable, bool primask, bool faultmask);
  void send_event() { exceptions_.event = true; }
  void set_sp(std::uint32_t value) { r[kSp] = value & ~3U; }
  void add_cycles(std::uint32_t count) { cycles_ += count; }
  void refund_cycles(std::uint32_t count) { cycles_ -= count; }
  [[noreturn]] void undefined(const Insn* insn) const;

 private:
  friend class Decoder;

  enum MarkKind : std::uint8_t { kStop = 1, kProbe = 2, kProbeReturn = 4 };
  struct Mark {
    std::uint8_t kinds;
    Handler original;
  };
  // A call of a probed function that has not returned: its place, and the counters at its entry.
  struct OpenProbe {
    std::uint32_t function;
    std::uint32_t return_address;
    std::uint32_t sp;
    std::uint64_t instructions;
    std::uint64_t nested;
    std::size_t depth;
  };
  struct OpenException {
    std::uint8_t number;
    std::uint64_t instructions;
    std::uint64_t cycles;
    std::uint64_t nested;
  };

  bool follow(std::uint32_t polled, std::set<std::uint32_t>& loop, bool record);
  void forget_flash_code();
  void burst();
  bool prepare(std::uint64_t until);
  static constexpr bool kSynchronous = true;
  static constexpr bool kAsynchronous = false;
  void raise(const Fault& fault, bool synchronous);
  void lock_up(const std::string& why);
  void enter_exception();
  void enter_handler(std::uint32_t exc_return);
  void push_frame();
  const Insn* return_from_exception(std::uint32_t exc_return);
  void pop_frame(std::uint32_t exc_return);
  void fail_return(std::uint32_t exc_return);
  void use_psp(bool psp);
  void resume_at(std::uint32_t address, std::uint8_t it);
  std::uint8_t it_state() const { return ip_->it; }

  const Insn* slow_slot(std::uint32_t address);
  const Insn* bad_slot(std::uint32_t address);
  std::uint32_t slow_load(std::uint32_t address, std::uint32_t size);
  void slow_store(std::uint32_t address, std::uint32_t value, std::uint32_t size);
  [[noreturn]] void throw_unaligned(std::uint32_t address) const;
  void set_mark(std::uint32_t address, MarkKind kind);
  void clear_mark(std::uint32_t address, MarkKind kind);
  void close_probes(std::uint32_t address);
  void note_entry(std::uint8_t number);
  void note_return();

  Memory& memory_;
  Bus& bus_;
  Scheduler& scheduler_;
  Exceptions& exceptions_;
  std::uint8_t* ram_;
  Insn* flash_slots_ = nullptr;

  const Insn* ip_ = nullptr;
  std::uint64_t cycles_ = 0;
  std::uint64_t stop_at_ = 0;  // burst() runs until this cycle; 0 makes it return
  std::uint64_t instructions_ = 0;
  std::uint64_t sleep_cycles_ = 0;
  bool leave_ = false;  // run() returns
  bool held_ = false;   // in reset
  bool flush_ = false;  // decoded flash is stale
  bool sleeping_ = false;
  bool waiting_for_event_ = false;
  Halt halt_ = Halt::kNone;

  std::uint32_t ipsr_ = 0;
  std::uint32_t other_sp_ = 0;  // the stack pointer that r13 is not
  bool spsel_ = false;          // CONTROL.SPSEL
  bool uses_psp_ = false;
  bool unprivileged_thread_ = false;  // CONTROL.nPRIV
  bool thumb_ = true;

  std::uint32_t flash_wait_states_ = 0;
  Insn bad_slot_{};
  std::uint32_t bad_pc_ = 0;  // the address that bad_slot_ stands for

  std::map<std::uint32_t, Mark> marks_;
  std::uint32_t step_over_ = 1;  // address whose breakpoint is passed once; odd: none
  std::map<std::uint32_t, ProbeStats> probes_;
  std::vector<OpenProbe> open_probes_;
  std::array<ExceptionStats, exc::kCount> stats_{};
  std::vector<OpenException> open_exceptions_;
  // Instructions of finished handlers that preempted each depth of nesting.
  std::array<std::uint64_t, exc::kCount + 2> nested_{};
};

}  // namespace due_emulator
