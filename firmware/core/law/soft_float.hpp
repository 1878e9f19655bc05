// Single precision by integer arithmetic, with which the tapes calculate.
//
// The same lines give the same bits on every board and on every host, whatever their compilers,
// libraries and floating-point units do; and their time hardly depends on the numbers, so that a
// tape's worst case is near to what it takes. Rounded to nearest, ties to even, like IEEE 754;
// numbers below the normal ones are zero, and there is one "no number".
#pragma once

#include <cstdint>
#include <cstring>

#include "control/fixed.hpp"

namespace heli::law {

using Bits = std::uint32_t;

inline constexpr Bits kSign = 0x80000000U;
inline constexpr Bits kInfinity = 0x7f800000U;
inline constexpr Bits kNoNumber = 0x7fc00000U;
inline constexpr Bits kOne = 0x3f800000U;
inline constexpr Bits kFractionMask = 0x007fffffU;
inline constexpr Bits kHiddenBit = 0x00800000U;
inline constexpr std::int32_t kBias = 127;

constexpr std::uint32_t exponent_of(Bits a) { return (a >> 23U) & 0xffU; }
constexpr Bits mantissa_of(Bits a) { return (a & kFractionMask) | kHiddenBit; }
constexpr bool is_no_number(Bits a) { return (a << 1U) > (kInfinity << 1U); }
constexpr bool is_finite(Bits a) { return exponent_of(a) != 0xffU; }
// As a condition: whatever is not zero. Not for "no number".
constexpr bool holds(Bits a) { return (a << 1U) != 0U; }
constexpr Bits truth(bool condition) { return condition ? kOne : 0U; }

inline Bits bits_of(float value) {
  Bits bits = 0;
  std::memcpy(&bits, &value, sizeof bits);
  return bits;
}

// Numbers below the normal ones become zero, also in inputs and constants.
constexpr Bits flushed(Bits a) { return exponent_of(a) == 0U ? a & kSign : a; }

// `mantissa` has its leading bit at the top, and in its last bit whatever was lost below it.
constexpr Bits rounded(Bits sign, std::int32_t exponent, std::uint32_t mantissa) {
  const auto below = static_cast<std::uint32_t>(exponent) - 1U;
  if (below >= 254U) {
    return exponent <= 0 ? sign : sign | kInfinity;
  }
  // Half a last bit and no more is rounded to even. A carry goes on into the exponent.
  const std::uint32_t behind = (mantissa & 0xffU) + ((mantissa >> 8U) & 1U) + 0x7fU;
  return sign + ((below << 23U) + (mantissa >> 8U) + (behind >> 8U));
}

// `a` becomes the operand of greater size. Both mantissas get 7 bits more below them: enough to
// round correctly, while the sum of two still fits into 32 bits.
constexpr Bits add(Bits a, Bits b) {
  if ((a << 1U) < (b << 1U)) {
    const Bits greater = b;
    b = a;
    a = greater;
  }
  const std::uint32_t exponent = exponent_of(a);
  const std::uint32_t other = exponent_of(b);
  if (exponent == 0xffU) {
    const bool opposed = other == 0xffU && a != b;
    return is_no_number(a) || opposed ? kNoNumber : a;
  }
  // -0 and -0 give -0; any other two zeros give 0.
  if (other == 0U) {
    return exponent == 0U ? a & b & kSign : a;
  }
  const std::uint32_t greater = mantissa_of(a) << 7U;
  std::uint32_t lesser = mantissa_of(b) << 7U;
  const std::uint32_t shift = exponent - other;
  // Bits that are shifted out only have to say that they were there: in the last bit. Beyond 26
  // places that is all that can reach the result.
  if (shift > 26U) {
    lesser = 1U;
  } else if (shift != 0U) {
    const std::uint32_t lost = lesser << (32U - shift);
    lesser = (lesser >> shift) | (lost != 0U ? 1U : 0U);
  }
  const std::uint32_t sum = ((a ^ b) & kSign) != 0U ? greater - lesser : greater + lesser;
  if (sum == 0U) {
    return 0U;
  }
  const auto zeros = static_cast<std::uint32_t>(__builtin_clz(sum));
  return rounded(a & kSign, static_cast<std::int32_t>(exponent + 1U - zeros), sum << zeros);
}

constexpr Bits subtract(Bits a, Bits b) { return add(a, b ^ kSign); }

constexpr Bits multiply(Bits a, Bits b) {
  const Bits sign = (a ^ b) & kSign;
  const std::uint32_t first = exponent_of(a);
  const std::uint32_t second = exponent_of(b);
  // One comparison for both: exponent 0 is zero, exponent 255 is infinity or "no number".
  if (first - 1U >= 254U || second - 1U >= 254U) {
    if (first == 0xffU || second == 0xffU) {
      const bool nothing = is_no_number(a) || is_no_number(b) || first == 0U || second == 0U;
      return nothing ? kNoNumber : sign | kInfinity;
    }
    return sign;
  }
  const std::uint64_t product = static_cast<std::uint64_t>((a << 8U) | kSign) * ((b << 8U) | kSign);
  auto high = static_cast<std::uint32_t>(product >> 32U);
  auto exponent = static_cast<std::int32_t>(first + second) - (kBias - 1);
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
  const std::uint32_t first = exponent_of(a);
  const std::uint32_t second = exponent_of(b);
  if (first == 0xffU || second == 0xffU) {
    if (is_no_number(a) || is_no_number(b) || first == second) {
      return kNoNumber;
    }
    return first == 0xffU ? sign | kInfinity : sign;
  }
  if (second == 0U) {
    return first == 0U ? kNoNumber : sign | kInfinity;
  }
  if (first == 0U) {
    return sign;
  }
  std::uint32_t rest = mantissa_of(a);
  const std::uint32_t divisor = mantissa_of(b);
  auto exponent = static_cast<std::int32_t>(first) - static_cast<std::int32_t>(second) + kBias;
  if (rest < divisor) {
    rest <<= 1U;
    --exponent;
  }
  rest -= divisor;
  std::uint32_t quotient = 1U;
  for (int step = 0; step < 3; ++step) {
    rest <<= 8U;
    const std::uint32_t digit = rest / divisor;
    rest -= digit * divisor;
    quotient = (quotient << 8U) | digit;
  }
  rest <<= 7U;
  const std::uint32_t digit = rest / divisor;
  rest -= digit * divisor;
  quotient = (quotient << 7U) | digit;
  return rounded(sign, exponent, quotient | (rest != 0U ? 1U : 0U));
}

// Whole numbers in the order of the floats, both zeros the same. Not for "no number".
constexpr std::int32_t place(Bits a) {
  return static_cast<std::int32_t>((a & kSign) != 0U ? kSign - a : a);
}

// IEEE 754 lets a comparison with "no number" be false, and fmin and fmax take the other operand.
// Here the result is "no number": a limit or a condition that hid it would have the motors act on
// whatever is on its other side, and the guard would notice only when the arm has fallen.
constexpr bool any_no_number(Bits a, Bits b) { return is_no_number(a) || is_no_number(b); }
constexpr Bits truth_of(Bits a, Bits b, bool condition) {
  return any_no_number(a, b) ? kNoNumber : truth(condition);
}

constexpr Bits less(Bits a, Bits b) { return truth_of(a, b, place(a) < place(b)); }
constexpr Bits less_equal(Bits a, Bits b) { return truth_of(a, b, place(a) <= place(b)); }
constexpr Bits equal(Bits a, Bits b) { return truth_of(a, b, place(a) == place(b)); }
constexpr Bits not_equal(Bits a, Bits b) { return truth_of(a, b, place(a) != place(b)); }
constexpr Bits both(Bits a, Bits b) { return truth_of(a, b, holds(a) && holds(b)); }
constexpr Bits either(Bits a, Bits b) { return truth_of(a, b, holds(a) || holds(b)); }
constexpr Bits negation(Bits a) { return is_no_number(a) ? kNoNumber : truth(!holds(a)); }
// The operand that is not selected has no effect, even if it is "no number".
constexpr Bits select(Bits a, Bits b) {
  if (is_no_number(a)) {
    return kNoNumber;
  }
  return holds(a) ? b : 0U;
}

// Whole numbers in the order of the floats, -0 below 0. Not for "no number".
constexpr std::int32_t rank(Bits a) {
  const auto turned = static_cast<Bits>(static_cast<std::int32_t>(a) >> 31);
  return static_cast<std::int32_t>(a ^ (turned >> 1U));
}

constexpr Bits minimum(Bits a, Bits b) {
  if (any_no_number(a, b)) {
    return kNoNumber;
  }
  return rank(b) < rank(a) ? b : a;
}

constexpr Bits maximum(Bits a, Bits b) {
  if (any_no_number(a, b)) {
    return kNoNumber;
  }
  return rank(b) > rank(a) ? b : a;
}

// Exponent 127 is that of 1; from 150 = 127 + 23 on, all bits of a number are whole.
constexpr Bits floor(Bits a) {
  const std::uint32_t exponent = exponent_of(a);
  if (exponent >= 150U) {
    return is_no_number(a) ? kNoNumber : a;
  }
  if (exponent < 127U) {
    return (a & kSign) != 0U && holds(a) ? kSign | kOne : a & kSign;
  }
  const Bits behind = kFractionMask >> (exponent - 127U);
  if ((a & behind) == 0U) {
    return a;
  }
  return ((a & kSign) != 0U ? a + behind : a) & ~behind;
}

// raw / 2^fraction, to the nearest.
constexpr Bits from_fixed(std::int32_t raw, std::int32_t fraction) {
  if (raw == 0) {
    return 0U;
  }
  const Bits sign = raw < 0 ? kSign : 0U;
  const auto size =
      raw < 0 ? 0U - static_cast<std::uint32_t>(raw) : static_cast<std::uint32_t>(raw);
  const int zeros = __builtin_clz(size);
  return rounded(sign, kBias + 31 - zeros - fraction, size << zeros);
}

constexpr Bits from_quantity(control::Quantity value) { return from_fixed(value.raw(), 24); }

// The nearest whole number, halves away from zero, or the end of the range; 0 for "no number".
// Exponents: 126 is that of 1/2, from 150 on all bits are whole, 158 is that of 2^31.
constexpr std::int32_t to_whole(Bits a) {
  const std::uint32_t exponent = exponent_of(a);
  if (is_no_number(a) || exponent < 126U) {
    return 0;
  }
  const bool negative = (a & kSign) != 0U;
  if (exponent >= 158U) {
    return negative ? INT32_MIN : INT32_MAX;
  }
  const std::uint32_t mantissa = mantissa_of(a);
  const std::uint32_t size = exponent >= 150U ? mantissa << (exponent - 150U)
                                              : ((mantissa >> (149U - exponent)) + 1U) >> 1U;
  return negative ? -static_cast<std::int32_t>(size) : static_cast<std::int32_t>(size);
}

// The nearest quantity, or the end of the range. Not for "no number".
inline control::Quantity to_quantity(Bits a) {
  float value = 0.0F;
  std::memcpy(&value, &a, sizeof value);
  return control::quantity_of(value);
}

}  // namespace heli::law
