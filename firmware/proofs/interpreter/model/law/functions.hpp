// What the proofs of the interpreter put in place of the functions: numbers of any bits.
#pragma once

#include "law/soft_float.hpp"

namespace heli::law {

inline Bits square_root(Bits a) { return some(a, a); }
inline Bits sine(Bits a) { return some(a, a); }
inline Bits cosine(Bits a) { return some(a, a); }
inline Bits tangent(Bits a) { return some(a, a); }
inline Bits arctangent(Bits y, Bits x) { return some(y, x); }
inline Bits hyperbolic_tangent(Bits a) { return some(a, a); }
inline Bits exponential(Bits a) { return some(a, a); }

}  // namespace heli::law
