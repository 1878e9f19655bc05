// Single precision by integer arithmetic, with which the tapes calculate.
//
// This code gives the same bits on every board and on every host, independent of compiler, library
// and floating-point unit. Its time hardly depends on the operands, so that a tape's worst case is
// near its usual time. Results are rounded to nearest, ties to even, like IEEE 754. Subnormal
// numbers are zero, and there is one NaN. A float has 1 bit of sign, 8 of exponent (bias 127), 23
// of fraction.
#pragma once

#include <cstdint>
#include <cstring>

#include "control/fixed.hpp"

namespace heli::law {

using Bits = std::uint32_t;

inline constexpr Bits kSign = 0x80000000U;
inline constexpr Bits kInfinity = 0x7f800000U;
inline constexpr Bits kNan = 0x7fc00000U;
inline constexpr Bits kOne = 0x3f800000U;
inline constexpr Bits kFractionMask = 0x007fffffU;
inline constexpr Bits kHiddenBit = 0x00800000U;
inline constexpr std::int32_t kBias = 127;

constexpr std::uint32_t exponent_of(Bits a) { return (a >> 23U) & 0xffU; }
constexpr Bits mantissa_of(Bits a) { return (a & kFractionMask) | kHiddenBit; }
constexpr bool is_nan(Bits a) { return (a << 1U) > (kInfinity << 1U); }
constexpr bool is_finite(Bits a) { return exponent_of(a) != 0xffU; }
// As a condition: every number except zero. Not for NaN.
constexpr bool is_true(Bits a) { return (a << 1U) != 0U; }
// 1.0 or 0.0.
constexpr Bits from_condition(bool condition) { return condition ? kOne : 0U; }

inline Bits bits_of(float value) {
  Bits bits = 0;
  std::memcpy(&bits, &value, sizeof bits);
  return bits;
}

// Numbers below the normal ones become zero, also in inputs and constants.
constexpr Bits flushed(Bits a) { return exponent_of(a) == 0U ? a & kSign : a; }

// Packs a float and rounds it. `mantissa` has its leading bit at the top; its last bit must be set
// if any lower bit was lost. `exponent` is biased; out of range it gives zero or infinity.
constexpr Bits rounded(Bits sign, std::int32_t exponent, std::uint32_t mantissa) {
  const auto exponent_minus_1 = static_cast<std::uint32_t>(exponent) - 1U;
  if (exponent_minus_1 >= 254U) {
    return exponent <= 0 ? sign : sign | kInfinity;
  }
  // Half a last bit and no more is rounded to even. A carry goes on into the exponent.
  const std::uint32_t rounding_sum = (mantissa & 0xffU) + ((mantissa >> 8U) & 1U) + 0x7fU;
  return sign + ((exponent_minus_1 << 23U) + (mantissa >> 8U) + (rounding_sum >> 8U));
}

// `a` becomes the operand of greater size. Both mantissas get 7 bits more below them: enough to
// round correctly, while the sum of two still fits into 32 bits.
constexpr Bits add(Bits a, Bits b) {
  if ((a << 1U) < (b << 1U)) {
    const Bits larger = b;
    b = a;
    a = larger;
  }
  const std::uint32_t exponent = exponent_of(a);
  const std::uint32_t exponent_b = exponent_of(b);
  if (exponent == 0xffU) {
    const bool opposed = exponent_b == 0xffU && a != b;
    return is_nan(a) || opposed ? kNan : a;
  }
  // -0 and -0 give -0; any other two zeros give 0.
  if (exponent_b == 0U) {
    return exponent == 0U ? a & b & kSign : a;
  }
  const std::uint32_t larger = mantissa_of(a) << 7U;
  std::uint32_t smaller = mantissa_of(b) << 7U;
  const std::uint32_t shift = exponent - exponent_b;
  // Bits that are shifted out only have to say that they were there: in the last bit. Beyond 26
  // places that is all that can reach the result.
  if (shift > 26U) {
    smaller = 1U;
  } else if (shift != 0U) {
    const std::uint32_t lost = smaller << (32U - shift);
    smaller = (smaller >> shift) | (lost != 0U ? 1U : 0U);
  }
  const std::uint32_t sum = ((a ^ b) & kSign) != 0U ? larger - smaller : larger + smaller;
  if (sum == 0U) {
    return 0U;
  }
  const auto zeros = static_cast<std::uint32_t>(__builtin_clz(sum));
  return rounded(a & kSign, static_cast<std::int32_t>(exponent + 1U - zeros), sum << zeros);
}

constexpr Bits subtract(Bits a, Bits b) { return add(a, b ^ kSign); }

constexpr Bits multiply(Bits a, Bits b) {
  const Bits sign = (a ^ b) & kSign;
  const std::uint32_t exponent_a = exponent_of(a);
  const std::uint32_t exponent_b = exponent_of(b);
  // One comparison for both: exponent 0 is zero, exponent 255 is infinity or NaN.
  if (exponent_a - 1U >= 254U || exponent_b - 1U >= 254U) {
    if (exponent_a == 0xffU || exponent_b == 0xffU) {
      const bool undefined = is_nan(a) || is_nan(b) || exponent_a == 0U || exponent_b == 0U;
      return undefined ? kNan : sign | kInfinity;
    }
    return sign;
  }
  const std::uint64_t product = static_cast<std::uint64_t>((a << 8U) | kSign) * ((b << 8U) | kSign);
  auto high = static_cast<std::uint32_t>(product >> 32U);
  auto exponent = static_cast<std::int32_t>(exponent_a + exponent_b) - (kBias - 1);
  // The lower half holds 16 bits: one bit says whether any of them is set.
  high |= static_cast<std::uint32_t>(product) != 0U ? 1U : 0U;
  if ((high & kSign) == 0U) {
    high <<= 1U;
    --exponent;
  }
  return rounded(sign, exponent, high);
}

// By the processor's own division of whole numbers, eight bits at a time.
constexpr Bits divide(Bits a, Bits b) {
  const Bits sign = (a ^ b) & kSign;
  const std::uint32_t exponent_a = exponent_of(a);
  const std::uint32_t exponent_b = exponent_of(b);
  if (exponent_a == 0xffU || exponent_b == 0xffU) {
    if (is_nan(a) || is_nan(b) || exponent_a == exponent_b) {
      return kNan;
    }
    return exponent_a == 0xffU ? sign | kInfinity : sign;
  }
  if (exponent_b == 0U) {
    return exponent_a == 0U ? kNan : sign | kInfinity;
  }
  if (exponent_a == 0U) {
    return sign;
  }
  std::uint32_t remainder = mantissa_of(a);
  const std::uint32_t divisor = mantissa_of(b);
  auto exponent =
      static_cast<std::int32_t>(exponent_a) - static_cast<std::int32_t>(exponent_b) + kBias;
  if (remainder < divisor) {
    remainder <<= 1U;
    --exponent;
  }
  // The quotient is from 1 to 2. Behind its leading 1, three times 8 bits and once 7 make 32 bits.
  // A remainder has 24 bits, so that 8 more is what one division of 32 bits can give.
  remainder -= divisor;
  std::uint32_t quotient = 1U;
  for (int step = 0; step < 3; ++step) {
    remainder <<= 8U;
    const std::uint32_t digit = remainder / divisor;
    remainder -= digit * divisor;
    quotient = (quotient << 8U) | digit;
  }
  remainder <<= 7U;
  const std::uint32_t digit = remainder / divisor;
  remainder -= digit * divisor;
  quotient = (quotient << 7U) | digit;
  return rounded(sign, exponent, quotient | (remainder != 0U ? 1U : 0U));
}

// Whole numbers in the order of the floats, both zeros the same. Not for NaN.
constexpr std::int32_t order_key(Bits a) {
  return static_cast<std::int32_t>((a & kSign) != 0U ? kSign - a : a);
}

// IEEE 754 lets a comparison with NaN be false, and fmin and fmax take the other operand.
// Here the result is NaN: a limit or a condition that hid it would have the motors act on
// whatever is on its other side, and the guard would notice only when the arm has fallen.
constexpr bool any_nan(Bits a, Bits b) { return is_nan(a) || is_nan(b); }
constexpr Bits condition_value(Bits a, Bits b, bool condition) {
  return any_nan(a, b) ? kNan : from_condition(condition);
}

constexpr Bits less(Bits a, Bits b) { return condition_value(a, b, order_key(a) < order_key(b)); }
constexpr Bits less_equal(Bits a, Bits b) {
  return condition_value(a, b, order_key(a) <= order_key(b));
}
constexpr Bits equal(Bits a, Bits b) { return condition_value(a, b, order_key(a) == order_key(b)); }
constexpr Bits not_equal(Bits a, Bits b) {
  return condition_value(a, b, order_key(a) != order_key(b));
}
constexpr Bits both(Bits a, Bits b) { return condition_value(a, b, is_true(a) && is_true(b)); }
constexpr Bits either(Bits a, Bits b) { return condition_value(a, b, is_true(a) || is_true(b)); }
constexpr Bits negation(Bits a) { return is_nan(a) ? kNan : from_condition(!is_true(a)); }
// The operand that is not selected has no effect, even if it is NaN.
constexpr Bits select(Bits a, Bits b) {
  if (is_nan(a)) {
    return kNan;
  }
  return is_true(a) ? b : 0U;
}

// Whole numbers in the order of the floats, -0 below 0. Not for NaN.
constexpr std::int32_t total_order_key(Bits a) {
  const auto sign_mask = static_cast<Bits>(static_cast<std::int32_t>(a) >> 31);
  return static_cast<std::int32_t>(a ^ (sign_mask >> 1U));
}

constexpr Bits minimum(Bits a, Bits b) {
  if (any_nan(a, b)) {
    return kNan;
  }
  return total_order_key(b) < total_order_key(a) ? b : a;
}

constexpr Bits maximum(Bits a, Bits b) {
  if (any_nan(a, b)) {
    return kNan;
  }
  return total_order_key(b) > total_order_key(a) ? b : a;
}

// Exponent 127 is that of 1; from 150 = 127 + 23 on, all bits of a number are whole.
constexpr Bits floor(Bits a) {
  const std::uint32_t exponent = exponent_of(a);
  if (exponent >= 150U) {
    return is_nan(a) ? kNan : a;
  }
  if (exponent < 127U) {
    return (a & kSign) != 0U && is_true(a) ? kSign | kOne : a & kSign;
  }
  const Bits fraction_mask = kFractionMask >> (exponent - 127U);
  if ((a & fraction_mask) == 0U) {
    return a;
  }
  return ((a & kSign) != 0U ? a + fraction_mask : a) & ~fraction_mask;
}

// raw / 2^fraction, to the nearest.
constexpr Bits from_fixed(std::int32_t raw, std::int32_t fraction) {
  if (raw == 0) {
    return 0U;
  }
  const Bits sign = raw < 0 ? kSign : 0U;
  const auto magnitude =
      raw < 0 ? 0U - static_cast<std::uint32_t>(raw) : static_cast<std::uint32_t>(raw);
  const int zeros = __builtin_clz(magnitude);
  return rounded(sign, kBias + 31 - zeros - fraction, magnitude << zeros);
}

constexpr Bits from_quantity(control::Quantity value) { return from_fixed(value.raw(), 24); }

// The nearest whole number, halves away from zero, or the end of the range; 0 for NaN.
// Exponents: 126 is that of 1/2, from 150 on all bits are whole, 158 is that of 2^31.
constexpr std::int32_t to_whole(Bits a) {
  const std::uint32_t exponent = exponent_of(a);
  if (is_nan(a) || exponent < 126U) {
    return 0;
  }
  const bool negative = (a & kSign) != 0U;
  if (exponent >= 158U) {
    return negative ? INT32_MIN : INT32_MAX;
  }
  const std::uint32_t mantissa = mantissa_of(a);
  const std::uint32_t magnitude = exponent >= 150U ? mantissa << (exponent - 150U)
                                                   : ((mantissa >> (149U - exponent)) + 1U) >> 1U;
  return negative ? -static_cast<std::int32_t>(magnitude) : static_cast<std::int32_t>(magnitude);
}

// The nearest quantity, or the end of the range. Not for NaN.
inline control::Quantity to_quantity(Bits a) {
  float value = 0.0F;
  std::memcpy(&value, &a, sizeof value);
  return control::quantity_of(value);
}

}  // namespace heli::law
