// What the proofs of the interpreter put in place of the functions: each harness defines a result.
#pragma once

#include "law/soft_float.hpp"

namespace heli::law {

inline Bits square_root(Bits a) { return result_of(a, a); }
inline Bits sine(Bits a) { return result_of(a, a); }
inline Bits cosine(Bits a) { return result_of(a, a); }
inline Bits tangent(Bits a) { return result_of(a, a); }
inline Bits arctangent(Bits y, Bits x) { return result_of(y, x); }
inline Bits hyperbolic_tangent(Bits a) { return result_of(a, a); }
inline Bits exponential(Bits a) { return result_of(a, a); }

}  // namespace heli::law
