// One instruction with any operands, anywhere on the tape, and a parameter of any number.
#include "any.hpp"
#include "interpreter/invariant.hpp"
#include "law/tape.cpp"
#include "no_interrupt.hpp"

using heli::law::Bits;
using heli::law::LawState;
using heli::law::Tape;
using heli::proofs::any;

// Contract: any bits.
Bits heli::law::result_of(Bits, Bits) { return any<Bits>(); }

namespace {

Tape tape;
std::uint32_t cell;  // any cell

// A tape of any content, and any cell.
void put_in_any_state() {
  CONSTANT(Tape::kWords);
  CONSTANT(Tape::kCells);
  tape = any<Tape>();
  cell = any<std::uint32_t>();
  ASSUME(cell < Tape::kCells);
}

}  // namespace

// Executes one instruction that the verifier has accepted.
void step_instruction() {
  put_in_any_state();
  const auto place = any<std::uint32_t>();
  ASSUME(place < Tape::kWords);
  const std::uint32_t word = tape.image_[place];
  const bool sums =
      word >> 27U == static_cast<std::uint32_t>(heli::link::Operation::sum_of_products);
  const std::uint32_t terms = sums ? word & 0x1ffU : 0U;
  // The verifier's bound is 64; more terms run the same code.
  ASSUME(place + terms < Tape::kWords && terms <= 3U && (!sums || terms > 0U));
  const Bits before = tape.cells_[cell];

  tape.execute(tape.image_ + place, tape.image_ + place + terms + 1U);

  CLAIM(tape.image_[place] == word, "the tape stays as it is");
  CLAIM(cell == ((word >> 18U) & 0x1ffU) || tape.cells_[cell] == before,
        "an instruction changes no cell but its own");
}

// Sets a parameter of any number on a verified tape.
void step_parameter() {
  put_in_any_state();
  tape.stored_.value_ = LawState::ready;
  ASSUME(heli::proofs::holds_verified(tape));
  const auto index = any<std::uint32_t>();
  const Bits before = tape.cells_[cell];

  const bool set = tape.set_parameter(index, any<Bits>());

  CLAIM(set == (index < tape.shape_.parameters), "a parameter that does not exist is refused");
  CLAIM(tape.cells_[cell] == before || (set && cell == tape.shape_.first_parameter() + index),
        "a parameter changes no cell but its own");
}
