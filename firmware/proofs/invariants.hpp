// The written invariants: what the proofs assume before a call and prove after it. Tests assert
// them on flights, so that none excludes a state that occurs.
#pragma once

#include "law/tape.hpp"
#include "link/parser.hpp"

namespace heli::proofs {

inline bool holds(const link::Parser& parser) {
  return parser.decoded_count_ <= link::Parser::kMaxBytes;
}

}  // namespace heli::proofs
