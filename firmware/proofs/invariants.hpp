// The written invariants: what the proofs assume before a call and prove after it. Tests assert
// them on flights, so that none excludes a state that occurs.
#pragma once

#include "law/tape.hpp"
#include "link/parser.hpp"

namespace heli::proofs {

inline bool holds(const link::Parser& parser) {
  return parser.decoded_count_ <= link::Parser::kMaxBytes;
}

// A law flies only if it was verified, and an upload fits the tape.
inline bool holds(const law::Tape& tape) {
  const law::LawState stored = tape.stored_.value_;
  return (!tape.flying_.value_ || stored == law::LawState::ready) &&
         (stored != law::LawState::receiving ||
          (tape.expected_ <= law::Tape::kWords && tape.received_ <= tape.expected_));
}

}  // namespace heli::proofs
