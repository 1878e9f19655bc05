// What the proofs of uploads assume before a call and prove after it.
#pragma once

#include "law/tape.hpp"

namespace heli::proofs {

// A law flies only if it was verified, and an upload fits the tape.
inline bool holds(const law::Tape& tape) {
  const law::LawState stored = value_of(tape.stored_);
  return (!value_of(tape.flying_) || stored == law::LawState::ready) &&
         (stored != law::LawState::receiving ||
          (tape.expected_ <= law::Tape::kWords && tape.received_ <= tape.expected_));
}

}  // namespace heli::proofs
