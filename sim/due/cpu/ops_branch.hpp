// Handlers of branches, table branches and everything that concerns the processor itself. A handler
// executes the decoded instruction `i` on the processor `c` and returns the next instruction.
#pragma once

#include <cstdint>

#include "cpu/cpu.hpp"
#include "cpu/ops_data.hpp"
#include "cpu/ops_memory.hpp"

namespace due_emulator::ops {

// Wraps an instruction inside an IT block: if its condition (ITSTATE, upper four bits) fails, it is
// skipped and costs one cycle.
template <Handler kInner>
const Insn* conditional(Cpu& c, const Insn* i) {
  if (c.passes(static_cast<unsigned>(i->it) >> 4)) return kInner(c, i);
  c.refund_cycles(i->cycles - 1U);
  return next(i);
}

// Branches whose target lies in the same memory go by `step`; others by address.
inline const Insn* branch_near(Cpu&, const Insn* i) { return i + i->step; }
inline const Insn* branch_far(Cpu& c, const Insn* i) { return c.slot(i->imm); }

// B<c>. The frequent conditions need no call.
template <unsigned kCondition, bool kNear>
const Insn* branch_if(Cpu& c, const Insn* i) {
  bool taken = false;
  switch (kCondition) {
    case 0:  // EQ
      taken = c.z_src == 0;
      break;
    case 1:  // NE
      taken = c.z_src != 0;
      break;
    case 2:  // CS
      taken = c.carry != 0;
      break;
    case 3:  // CC
      taken = c.carry == 0;
      break;
    case 4:  // MI
      taken = (c.n_src >> 31) != 0;
      break;
    case 5:  // PL
      taken = (c.n_src >> 31) == 0;
      break;
    default:
      taken = c.passes(kCondition);
      break;
  }
  if (!taken) return next(i);
  c.add_cycles(i->extra);
  return kNear ? i + i->step : c.slot(i->imm);
}

// CBZ and CBNZ: branches if rn is 0, or if it is not; `ra` is 1 for CBNZ.
inline const Insn* compare_and_branch(Cpu& c, const Insn* i) {
  if ((c.r[i->rn] == 0) == (i->ra != 0)) return next(i);
  c.add_cycles(i->extra);
  return c.slot(i->imm);
}

// BL to a target in the same memory. `imm` is the return address, which goes to LR (r14).
inline const Insn* branch_link_near(Cpu& c, const Insn* i) {
  c.r[kLr] = i->imm;
  return i + i->step;
}

// BL to another memory: `imm` is the target, so the return address is computed.
inline const Insn* branch_link_far(Cpu& c, const Insn* i) {
  c.r[kLr] = (c.pc_of(i) + 4) | 1U;
  return c.slot(i->imm);
}

// BX: also returns from exceptions.
inline const Insn* branch_exchange(Cpu& c, const Insn* i) { return c.branch_exchange(c.r[i->rm]); }

// BLX: `imm` is the return address.
inline const Insn* branch_link_exchange(Cpu& c, const Insn* i) {
  const std::uint32_t target = c.r[i->rm];
  c.r[kLr] = i->imm;
  return c.branch_exchange(target);
}

// MOV PC and ADD PC: no change of instruction set, bit 0 is ignored.
inline const Insn* move_to_pc(Cpu& c, const Insn* i) { return c.slot(c.r[i->rm] & ~1U); }

// `imm` is the address that reading PC gives here.
inline const Insn* add_to_pc(Cpu& c, const Insn* i) { return c.slot((i->imm + c.r[i->rm]) & ~1U); }

// TBB and TBH: branches forward by twice entry number rm of a table at rn, or behind the
// instruction if rn is PC.
template <typename T>
const Insn* table_branch(Cpu& c, const Insn* i) {
  const std::uint32_t base = i->rn == kPc ? i->imm : c.r[i->rn];
  const std::uint32_t entry = c.load<T>(base + c.r[i->rm] * static_cast<std::uint32_t>(sizeof(T)));
  return c.slot(i->imm + 2 * entry);
}

inline const Insn* nop(Cpu&, const Insn* i) { return next(i); }
inline const Insn* undefined(Cpu& c, const Insn* i) { c.undefined(i); }
inline const Insn* no_coprocessor(Cpu&, const Insn*) { throw Fault{exc::kUsageFault, cfsr::kNoCp}; }
inline const Insn* supervisor_call(Cpu& c, const Insn* i) { return c.supervisor_call(i); }
inline const Insn* breakpoint(Cpu& c, const Insn* i) { return c.breakpoint_instruction(i); }
inline const Insn* wait_for_interrupt(Cpu& c, const Insn* i) { return c.wait_for_interrupt(i); }
inline const Insn* wait_for_event(Cpu& c, const Insn* i) { return c.wait_for_event(i); }
inline const Insn* send_event(Cpu& c, const Insn* i) {
  c.send_event();
  return next(i);
}

// CPS: `ra` bit 0 disables, bit 1 acts on PRIMASK, bit 2 on FAULTMASK.
inline const Insn* change_state(Cpu& c, const Insn* i) {
  c.change_processor_state((i->ra & 1U) != 0, (i->ra & 2U) != 0, (i->ra & 4U) != 0);
  return next(i);
}

// MRS and MSR: `imm` is SYSm, `ra` the mask.
inline const Insn* move_from_special(Cpu& c, const Insn* i) {
  c.r[i->rd] = c.read_special(i->imm);
  return next(i);
}

inline const Insn* move_to_special(Cpu& c, const Insn* i) {
  c.write_special(i->imm, c.r[i->rn], i->ra);
  return next(i);
}

}  // namespace due_emulator::ops
