// What a harness is written with: any value, what it assumes and what it claims.
#pragma once

namespace heli::proofs {

// A value about which nothing is known: the prover sees no body and returns every value.
template <class T>
T any();

}  // namespace heli::proofs

#define ASSUME(condition) __ESBMC_assume(condition)
#define CLAIM(condition, text) __ESBMC_assert(condition, text)
