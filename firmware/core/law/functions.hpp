// Square root, trigonometry and exponentials of the tapes, to about 1e-7 of their largest value.
#pragma once

#include "law/soft_float.hpp"

namespace heli::law {

// Rounded like IEEE 754; no number below 0.
Bits square_root(Bits a);

// Beyond 8192 rad the last bit of an angle is a milliradian, and such an angle is the result of a
// diverging law: the functions then return NaN.
Bits sine(Bits angle_rad);
Bits cosine(Bits angle_rad);
Bits tangent(Bits angle_rad);

Bits arctangent(Bits y, Bits x);
Bits hyperbolic_tangent(Bits a);
Bits exponential(Bits a);

}  // namespace heli::law
