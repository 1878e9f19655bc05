// What the proofs of the interpreter put in place of the arithmetic: each harness defines a result.
#pragma once

#include <cstdint>

#include "any.hpp"
#include "link/declaration.hpp"

namespace heli::law {

using Bits = std::uint32_t;

inline constexpr Bits kSign = 0x80000000U;

inline bool is_finite(Bits) { return proofs::any<bool>(); }
inline Bits flushed(Bits) { return proofs::any<Bits>(); }
// Contract of each operation.
Bits result_of(Bits a, Bits b);
inline Bits add(Bits a, Bits b) { return result_of(a, b); }
inline Bits subtract(Bits a, Bits b) { return result_of(a, b); }
inline Bits multiply(Bits a, Bits b) { return result_of(a, b); }
inline Bits divide(Bits a, Bits b) { return result_of(a, b); }
inline Bits minimum(Bits a, Bits b) { return result_of(a, b); }
inline Bits maximum(Bits a, Bits b) { return result_of(a, b); }
inline Bits less(Bits a, Bits b) { return result_of(a, b); }
inline Bits less_equal(Bits a, Bits b) { return result_of(a, b); }
inline Bits equal(Bits a, Bits b) { return result_of(a, b); }
inline Bits not_equal(Bits a, Bits b) { return result_of(a, b); }
inline Bits both(Bits a, Bits b) { return result_of(a, b); }
inline Bits either(Bits a, Bits b) { return result_of(a, b); }
inline Bits select(Bits a, Bits b) { return result_of(a, b); }
inline Bits negation(Bits a) { return result_of(a, a); }
inline Bits floor(Bits a) { return result_of(a, a); }

}  // namespace heli::law
