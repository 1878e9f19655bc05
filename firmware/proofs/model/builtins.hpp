// Compiler builtins that the prover does not know, with the meaning that GCC's manual gives them.
// In 32 bits: by sums of 64 bits, the solver ran out of memory.
#pragma once

namespace heli::proofs {

inline bool add_overflow(int a, int b, int* sum) {
  *sum = static_cast<int>(static_cast<unsigned>(a) + static_cast<unsigned>(b));
  return ((a ^ *sum) & (b ^ *sum)) < 0;
}

inline bool sub_overflow(int a, int b, int* difference) {
  *difference = static_cast<int>(static_cast<unsigned>(a) - static_cast<unsigned>(b));
  return ((a ^ b) & (a ^ *difference)) < 0;
}

}  // namespace heli::proofs

#define __builtin_add_overflow heli::proofs::add_overflow
#define __builtin_sub_overflow heli::proofs::sub_overflow
