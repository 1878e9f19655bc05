// What the proofs of the verifier show about a law that it accepted.
#pragma once

#include "law/tape.hpp"

namespace heli::proofs {

// The program is on the tape, and each of its ticks ends after the one before it.
inline bool holds_accepted(const law::Tape& tape) {
  if (value_of(tape.stored_) != law::LawState::ready) {
    return true;
  }
  if (tape.ticks_ == 0U || tape.ticks_ > link::kLawMaxTicks ||
      tape.outputs_at_ + tape.shape_.outputs() != tape.program_at_ ||
      tape.program_at_ + tape.shape_.instructions > law::Tape::kWords) {
    return false;
  }
  for (std::uint32_t tick = 1; tick < tape.ticks_; ++tick) {
    if (tape.ends_[tick - 1U] > tape.ends_[tick]) {
      return false;
    }
  }
  return tape.ends_[tape.ticks_ - 1U] == tape.shape_.instructions;
}

}  // namespace heli::proofs
