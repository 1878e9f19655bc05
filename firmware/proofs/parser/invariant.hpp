// What the proofs of the parser assume before a call and prove after it.
#pragma once

#include "link/parser.hpp"

namespace heli::proofs {

inline bool holds(const link::Parser& parser) {
  return parser.decoded_count_ <= link::Parser::kMaxBytes;
}

}  // namespace heli::proofs
