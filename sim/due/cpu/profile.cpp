// Breakpoints, function probes and the cost of exception handlers. A mark at an address replaces
// the handler of its decoded instruction by marked(), so that code without marks runs at full
// speed.
#include <algorithm>

#include "cpu/cpu.hpp"

namespace due_emulator {

// Adds one kind of mark to an address, and decodes its instruction again, which puts marked()
// there.
void Cpu::set_mark(std::uint32_t address, MarkKind kind) {
  Mark& mark = marks_[address & ~1U];
  if ((mark.kinds & kind) != 0) return;
  mark.kinds = static_cast<std::uint8_t>(mark.kinds | kind);
  CodeWindow* window = memory_.window_of(address);
  if (window == nullptr) return;
  if (window->slots() == nullptr) slow_slot(address & ~1U);
  resume_at(address & ~1U, window->slot(address & ~1U)->it);
}

// Takes one kind of mark away; the last one restores the instruction's own handler.
void Cpu::clear_mark(std::uint32_t address, MarkKind kind) {
  const auto mark = marks_.find(address & ~1U);
  if (mark == marks_.end()) return;
  mark->second.kinds = static_cast<std::uint8_t>(mark->second.kinds & ~kind);
  if (mark->second.kinds != 0) return;
  marks_.erase(mark);
  CodeWindow* window = memory_.window_of(address);
  if (window != nullptr) resume_at(address & ~1U, window->slot(address & ~1U)->it);
}

void Cpu::add_breakpoint(std::uint32_t address) { set_mark(address, kStop); }
void Cpu::remove_breakpoint(std::uint32_t address) {
  clear_mark(address, kStop);
  // One that is put there again later must stop again.
  if (step_over_ == (address & ~1U)) step_over_ = 1;
}

void Cpu::add_probe(std::uint32_t address) {
  probes_[address & ~1U];
  set_mark(address, kProbe);
}

ProbeStats Cpu::probe(std::uint32_t address) const {
  const auto probe = probes_.find(address & ~1U);
  return probe == probes_.end() ? ProbeStats{} : probe->second;
}

void Cpu::clear_stats() {
  stats_.fill({});
  for (auto& probe : probes_) probe.second = {};
}

// Handler of an instruction with marks. A breakpoint halts the processor before the instruction,
// and lets it pass when the run continues. A probe notes the call and marks its return address.
const Insn* Cpu::marked(const Insn* insn) {
  const std::uint32_t address = pc_of(insn);
  const Mark mark = marks_.at(address);
  if ((mark.kinds & kStop) != 0 && step_over_ != address) {
    halt_ = Halt::kBreakpoint;
    step_over_ = address;
    stop_at_ = 0;
    // The run loop has counted the instruction, which does not run now.
    --instructions_;
    cycles_ -= insn->cycles;
    return insn;
  }
  step_over_ = 1;
  if ((mark.kinds & kProbeReturn) != 0) close_probes(address);
  if ((mark.kinds & kProbe) != 0) {
    const std::uint32_t back = r[kLr] & ~1U;
    const std::size_t depth = open_exceptions_.size();
    open_probes_.push_back({address, back, r[kSp], instructions_ - 1, nested_[depth], depth});
    set_mark(back, kProbeReturn);
  }
  return mark.original(*this, insn);
}

// Ends the probed calls that return to this address with the stack pointer of their entry, and adds
// their instructions to the function's statistics; those of interrupts in between are not counted.
void Cpu::close_probes(std::uint32_t address) {
  const std::size_t depth = open_exceptions_.size();
  while (!open_probes_.empty()) {
    const OpenProbe probe = open_probes_.back();
    if (probe.return_address != address || probe.sp != r[kSp] || probe.depth != depth) return;
    open_probes_.pop_back();
    // The instruction at the return address has been counted already; it is not the function's.
    const std::uint64_t own =
        instructions_ - 1 - probe.instructions - (nested_[depth] - probe.nested);
    ProbeStats& stats = probes_[probe.function];
    ++stats.count;
    stats.instructions += own;
    stats.last_instructions = own;
    stats.max_instructions = std::max(stats.max_instructions, own);
  }
}

// An exception is entered: notes the counters, to find the cost of its handler at its return.
void Cpu::note_entry(std::uint8_t number) {
  // Depth of the handler that begins: 1 if it interrupts the thread.
  const std::size_t depth = std::min<std::size_t>(open_exceptions_.size() + 1, nested_.size() - 1);
  stats_[number].last_entry = cycles_;
  open_exceptions_.push_back({number, instructions_, cycles_, nested_[depth]});
}

// A handler returns: adds its cost to its statistics. nested_[depth] counts the instructions of all
// finished handlers that preempted code at that depth. What was counted at the handler's depth
// since its entry is not its cost; all its instructions are then counted at the depth that it
// preempted.
void Cpu::note_return() {
  if (open_exceptions_.empty()) return;
  const OpenException open = open_exceptions_.back();
  const std::size_t depth = std::min(open_exceptions_.size(), nested_.size() - 1);
  open_exceptions_.pop_back();
  const std::uint64_t total = instructions_ - open.instructions;
  const std::uint64_t own = total - (nested_[depth] - open.nested);
  nested_[depth - 1] += total;
  ExceptionStats& stats = stats_[open.number];
  ++stats.count;
  stats.instructions += own;
  stats.max_instructions = std::max(stats.max_instructions, own);
  stats.max_cycles = std::max(stats.max_cycles, cycles_ - open.cycles);
}

}  // namespace due_emulator
