// What the proofs of the interpreter assume before a call and prove after it.
#pragma once

#include "law/tape.hpp"

namespace heli::proofs {

// The parameters of a verified law are cells.
inline bool holds_verified(const law::Tape& tape) {
  const law::LawState stored = value_of(tape.stored_);
  return stored != law::LawState::ready ||
         (tape.shape_.parameters <= law::Tape::kCells &&
          tape.shape_.first_parameter() <= law::Tape::kCells - tape.shape_.parameters);
}

}  // namespace heli::proofs
