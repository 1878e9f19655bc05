// The functions of functions.hpp, by polynomials in fixed point. They run in the tick.
#include "law/functions.hpp"

#include <cstddef>

namespace heli::law {

namespace {

// Fixed point with 30 bits behind the point; the coefficients are Chebyshev fits over the ranges
// that the arguments are reduced to.
using Q30 = std::int32_t;

// Product, rounded down.
constexpr Q30 times(Q30 a, Q30 b) {
  return static_cast<Q30>((static_cast<std::int64_t>(a) * b) >> 30);
}

// Horner's scheme; the coefficient of x^0 is the first.
template <std::size_t kCount>
constexpr Q30 polynomial(const Q30 (&coefficients)[kCount], Q30 x) {
  Q30 sum = coefficients[kCount - 1];
  for (std::size_t k = kCount - 1; k > 0; --k) {
    sum = coefficients[k - 1] + times(sum, x);
  }
  return sum;
}

// sin(pi/2 f) / f and cos(pi/2 f) of f^2, for f up to 1/2: to 1e-10.
constexpr Q30 kSine[] = {1686629713, -693598667, 85569259, -5026471, 169873};
constexpr Q30 kCosine[] = {1073741824, -1324675869, 272375234, -22398330, 970265};
// 2^f for f from 0 to 1: to 1e-10.
constexpr Q30 kPower[] = {1073741824, 744261126, 257941088, 59598353,
                          10322455,   1442015,   153539,    23248};
// atan(q) / q of q^2, for q up to 1: to 3e-9.
constexpr Q30 kArctangent[] = {1073741821, -357913393, 214729366, -153132481, 117469492,
                               -89894352,  61701025,   -32982674, 11468335,   -1872285};
// tanh(x) / x of x^2, for x up to 1/4: to 3e-9.
constexpr Q30 kTanh[] = {1073741821, -357912582, 143056179, -55114107};

constexpr std::uint32_t kTwoOverPi = 2734261102U;  // 32 bits behind the point
constexpr std::uint32_t kLog2OfE = 3098164009U;    // 31 bits behind the point
constexpr std::int32_t kHalfPi = 843314857;        // 29 bits behind the point
constexpr std::int32_t kPi = 1686629713;           // 29 bits behind the point

constexpr std::uint32_t kLargestAngle = 127U + 13U;  // exponent of 8192
constexpr std::uint32_t kSmallAngle = 127U - 12U;    // below, sin(a) is a to half a bit

// An angle in units of a right angle, as its nearest whole number and the difference from it.
struct Quarter {
  std::uint32_t number;  // modulo 4
  Q30 from_middle;       // -1/2 to 1/2
};

// Of the angle's magnitude; its exponent is from kSmallAngle to below kLargestAngle.
Quarter quarter_of(Bits angle_rad) {
  const std::uint64_t exact = static_cast<std::uint64_t>(mantissa_of(angle_rad)) * kTwoOverPi;
  const auto phase =
      static_cast<std::uint32_t>(exact >> (127U + 23U + 32U - 30U - exponent_of(angle_rad)));
  const std::uint32_t shifted_phase = phase + (1U << 29U);
  return {shifted_phase >> 30U, static_cast<Q30>(shifted_phase & 0x3fffffffU) - (1 << 29)};
}

Bits sine_of(const Quarter& quarter) {
  // Odd quarters are a cosine; the second half of the turn is negative.
  const Q30 square = times(quarter.from_middle, quarter.from_middle);
  const Q30 magnitude = (quarter.number & 1U) != 0U
                            ? polynomial(kCosine, square)
                            : times(polynomial(kSine, square), quarter.from_middle);
  return from_fixed((quarter.number & 2U) != 0U ? -magnitude : magnitude, 30);
}

// Converts a number from 0 to 2.
Q30 to_q30(Bits a) {
  const std::uint32_t exponent = exponent_of(a);
  return exponent < 96U ? 0 : static_cast<Q30>((mantissa_of(a) << 7U) >> (127U - exponent));
}

}  // namespace

Bits square_root(Bits a) {
  const std::uint32_t exponent = exponent_of(a);
  if (exponent == 0U) {
    return a & kSign;
  }
  if ((a & kSign) != 0U || is_nan(a)) {
    return kNan;
  }
  if (exponent == 0xffU) {
    return a;
  }
  // One binary digit of the root at a time.
  std::uint32_t remainder = mantissa_of(a) << ((exponent & 1U) != 0U ? 1U : 2U);
  std::uint32_t root = 0;
  std::uint32_t doubled = 0;
  for (std::uint32_t digit = 0x01000000U; digit != 0U; digit >>= 1U) {
    const std::uint32_t candidate = doubled + digit;
    if (candidate <= remainder) {
      doubled = candidate + digit;
      remainder -= candidate;
      root += digit;
    }
    remainder <<= 1U;
  }
  const std::uint32_t mantissa = (root << 7U) | (remainder != 0U ? 1U : 0U);
  return rounded(0U, static_cast<std::int32_t>((exponent + 127U) >> 1U), mantissa);
}

Bits sine(Bits angle_rad) {
  const std::uint32_t exponent = exponent_of(angle_rad);
  if (exponent >= kLargestAngle) {
    return kNan;
  }
  if (exponent < kSmallAngle) {
    return angle_rad;
  }
  return sine_of(quarter_of(angle_rad)) ^ (angle_rad & kSign);
}

Bits cosine(Bits angle_rad) {
  const std::uint32_t exponent = exponent_of(angle_rad);
  if (exponent >= kLargestAngle) {
    return kNan;
  }
  if (exponent < kSmallAngle) {
    return kOne;
  }
  Quarter quarter = quarter_of(angle_rad);
  quarter.number += 1U;
  return sine_of(quarter);
}

Bits tangent(Bits angle_rad) { return divide(sine(angle_rad), cosine(angle_rad)); }

// atan(smaller / larger) from 0 to 45 degrees, then mirrored at 45 and at 90 degrees, as far as the
// signs and sizes of x and y demand. The result has the sign of y.
Bits arctangent(Bits y, Bits x) {
  if (is_nan(y) || is_nan(x)) {
    return kNan;
  }
  const Bits size_y = y & ~kSign;
  const Bits size_x = x & ~kSign;
  const bool steeper_than_45 = size_y > size_x;
  Bits ratio = kOne;
  if (size_y != size_x) {
    ratio = steeper_than_45 ? divide(size_x, size_y) : divide(size_y, size_x);
  } else if (!is_true(size_y)) {
    ratio = 0U;
  }
  const bool x_is_negative = (x & kSign) != 0U;
  if (!steeper_than_45 && !x_is_negative && exponent_of(ratio) < kSmallAngle) {
    return ratio | (y & kSign);
  }
  const Q30 ratio_q30 = to_q30(ratio);
  std::int32_t angle = times(polynomial(kArctangent, times(ratio_q30, ratio_q30)), ratio_q30) >> 1;
  if (steeper_than_45) {
    angle = kHalfPi - angle;
  }
  if (x_is_negative) {
    angle = kPi - angle;
  }
  return from_fixed(angle, 29) ^ (y & kSign);
}

// 2^(a log2(e)): the whole part is the result's exponent, the fraction goes through a polynomial.
Bits exponential(Bits a) {
  constexpr Bits kLargest = 0x42b20000U;  // 89
  if (is_nan(a)) {
    return kNan;
  }
  const bool negative = (a & kSign) != 0U;
  const std::uint32_t exponent = exponent_of(a);
  if (exponent > 127U + 6U || (a & ~kSign) >= kLargest) {
    return negative ? 0U : kInfinity;
  }
  if (exponent < 127U - 26U) {
    return kOne;
  }
  // In powers of two, 32 bits behind the point.
  const std::uint64_t magnitude = (static_cast<std::uint64_t>(mantissa_of(a)) * kLog2OfE) >>
                                  (127U + 23U + 31U - 32U - exponent);
  const std::uint64_t power = negative ? 0U - magnitude : magnitude;
  const auto fraction = static_cast<Q30>(static_cast<std::uint32_t>(power) >> 2U);
  const auto whole = static_cast<std::int32_t>(static_cast<std::uint32_t>(power >> 32U));
  const auto mantissa = static_cast<std::uint32_t>(polynomial(kPower, fraction));
  return rounded(0U, whole + kBias, mantissa << 1U);
}

// A polynomial for small numbers; otherwise 1 - 2 / (exp(2 |a|) + 1).
Bits hyperbolic_tangent(Bits a) {
  if (is_nan(a)) {
    return kNan;
  }
  const Bits sign = a & kSign;
  const Bits magnitude = a & ~kSign;
  if (magnitude < 0x3e800000U) {  // 1/4
    const Q30 x = to_q30(magnitude);
    return multiply(a, from_fixed(polynomial(kTanh, times(x, x)), 30));
  }
  if (magnitude >= 0x41200000U) {  // 10: 1 to half a bit
    return sign | kOne;
  }
  constexpr Bits kTwo = 0x40000000U;
  const Bits exp_2x = exponential(add(magnitude, magnitude));
  return sign | subtract(kOne, divide(kTwo, add(exp_2x, kOne)));
}

}  // namespace heli::law
