// A sum of products, rounded once at its end: most of a control law consists of such sums.
//
// A product and a sum of two floats take about 110 instructions, most of them for packing
// intermediate results as floats. Here a term takes a third of that.
#pragma once

#include <cstdint>

#include "law/soft_float.hpp"

namespace heli::law {

// The sum is a whole number of 64 bits on the scale of its largest term, where every factor has 31
// bits: it is right to about 2^-30 of the largest product.
class Sum {
 public:
  // Adds the product of two floats; `flip` is kSign where it is subtracted, otherwise 0.
  void add(Bits a, Bits b, Bits flip) {
    const std::uint32_t exponent_a = exponent_of(a);
    const std::uint32_t exponent_b = exponent_of(b);
    // One comparison for both: exponent 0 is zero, exponent 255 is infinity or NaN.
    if (exponent_a - 1U >= 254U || exponent_b - 1U >= 254U) {
      if (exponent_a == 0xffU || exponent_b == 0xffU) {
        exponent_ = kNotFinite;
      }
      return;
    }
    const auto exponent = static_cast<std::int32_t>(exponent_a + exponent_b);
    // Positive: this product is smaller than the largest so far, and its first factor loses bits.
    // Negative: it is the largest so far, and the sum loses bits instead.
    const std::int32_t exponent_deficit = exponent_ - exponent;
    std::uint32_t magnitude = ((a << 8U) | kSign) >> 1U;
    if (exponent_deficit < 0) {
      shift_right(static_cast<std::uint32_t>(-exponent_deficit));
      exponent_ = exponent;
    } else if (exponent_deficit < 31) {
      magnitude >>= static_cast<std::uint32_t>(exponent_deficit);
    } else {
      // None of the 31 bits is left.
      return;
    }
    const std::uint64_t product = static_cast<std::uint64_t>(magnitude) * mantissa_of(b);
    if (((a ^ b ^ flip) & kSign) == 0U) {
      sum_ += product;
    } else {
      sum_ -= product;
    }
  }

  // The sum as a float, rounded to nearest; NaN after an operand that was not finite.
  Bits value() const {
    if (exponent_ == kNotFinite) {
      return kNan;
    }
    if (sum_ == 0U) {
      return 0U;
    }
    const Bits sign = static_cast<Bits>(sum_ >> 32U) & kSign;
    const std::uint64_t magnitude = sign != 0U ? 0U - sum_ : sum_;
    const auto zeros = static_cast<std::uint32_t>(__builtin_clzll(magnitude));
    const std::uint64_t shifted = magnitude << zeros;
    const auto high = static_cast<std::uint32_t>(shifted >> 32U);
    const bool bits_lost = static_cast<std::uint32_t>(shifted) != 0U;
    // 1 times 1 is 2^53 at an exponent of twice the bias. It has 10 zeros in front, and as a float
    // its exponent is the bias.
    constexpr std::int32_t kScaleExponent = 2 * kBias - 10 - kBias;
    const std::int32_t exponent = exponent_ - static_cast<std::int32_t>(zeros) - kScaleExponent;
    return rounded(sign, exponent, high | (bits_lost ? 1U : 0U));
  }

 private:
  // Above all exponents of two factors: later products have no effect.
  static constexpr std::int32_t kNotFinite = 10000;

  // Arithmetic shift of the sum to the right. Computed in two halves, because the compiler's shift
  // of 64 bits by a variable takes twice as long.
  void shift_right(std::uint32_t bits) {
    const auto low = static_cast<std::uint32_t>(sum_);
    const auto high = static_cast<std::int32_t>(sum_ >> 32U);
    if (bits < 32U) {
      set(high >> bits, (low >> bits) | (static_cast<std::uint32_t>(high) << (32U - bits)));
    } else if (bits < 64U) {
      set(high >> 31, static_cast<std::uint32_t>(high >> (bits - 32U)));
    } else {
      set(high >> 31, static_cast<std::uint32_t>(high >> 31));
    }
  }
  void set(std::int32_t high, std::uint32_t low) {
    sum_ = static_cast<std::uint64_t>(static_cast<std::uint32_t>(high)) << 32U | low;
  }

  std::uint64_t sum_ = 0;      // of two's complement
  std::int32_t exponent_ = 0;  // sum of both factors' exponents, at which `sum_` counts
};

}  // namespace heli::law
