// What a harness is written with: any value, what it assumes and what it claims.
#pragma once

namespace heli::proofs {

// A value about which nothing is known: the prover sees no body and returns every value.
template <class T>
T any();

template <class T, T kValue>
struct Folded {
  static T value() { return kValue; }
};

}  // namespace heli::proofs

#define ASSUME(condition) __ESBMC_assume(condition)
// The prover initialises a class's static constants before the constants of namespaces, so that one
// which is made from those has any value. The compiler's value, a template's argument, is right.
#define CONSTANT(name) ASSUME((name) == (heli::proofs::Folded<decltype(+(name)), (name)>::value()))
#define CLAIM(condition, text) __ESBMC_assert(condition, text)
