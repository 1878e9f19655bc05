// Compiler builtins that the prover does not know, with the meaning that GCC's manual gives them.
#pragma once

namespace heli::proofs {

inline bool add_overflow(int a, int b, int* sum) {
  const long long exact = static_cast<long long>(a) + b;
  *sum = static_cast<int>(exact);
  return *sum != exact;
}

inline bool sub_overflow(int a, int b, int* difference) {
  const long long exact = static_cast<long long>(a) - b;
  *difference = static_cast<int>(exact);
  return *difference != exact;
}

}  // namespace heli::proofs

#define __builtin_add_overflow heli::proofs::add_overflow
#define __builtin_sub_overflow heli::proofs::sub_overflow
