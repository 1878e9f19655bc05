// What the proofs of the interpreter put in place of the arithmetic: numbers of any bits.
#pragma once

#include <cstdint>

#include "any.hpp"
#include "link/declaration.hpp"

namespace heli::law {

using Bits = std::uint32_t;

inline constexpr Bits kSign = 0x80000000U;

inline bool is_finite(Bits) { return proofs::any<bool>(); }
inline Bits flushed(Bits) { return proofs::any<Bits>(); }
inline Bits some(Bits, Bits) { return proofs::any<Bits>(); }
inline Bits add(Bits a, Bits b) { return some(a, b); }
inline Bits subtract(Bits a, Bits b) { return some(a, b); }
inline Bits multiply(Bits a, Bits b) { return some(a, b); }
inline Bits divide(Bits a, Bits b) { return some(a, b); }
inline Bits minimum(Bits a, Bits b) { return some(a, b); }
inline Bits maximum(Bits a, Bits b) { return some(a, b); }
inline Bits less(Bits a, Bits b) { return some(a, b); }
inline Bits less_equal(Bits a, Bits b) { return some(a, b); }
inline Bits equal(Bits a, Bits b) { return some(a, b); }
inline Bits not_equal(Bits a, Bits b) { return some(a, b); }
inline Bits both(Bits a, Bits b) { return some(a, b); }
inline Bits either(Bits a, Bits b) { return some(a, b); }
inline Bits select(Bits a, Bits b) { return some(a, b); }
inline Bits negation(Bits a) { return some(a, a); }
inline Bits floor(Bits a) { return some(a, a); }

}  // namespace heli::law
