// Fixed-point numbers, with which the tick calculates.
//
// A Cortex-M3 without FPU takes about 45 instructions for a float's sum and 33 for its product, but
// 8 and 11 for these. Every operation saturates instead of wrapping, so that a number that left its
// range still has the right sign and is larger than any limit.
#pragma once

#include <cstdint>
#include <cstring>

namespace heli::control {

constexpr std::int32_t saturated(std::int64_t value) {
  const auto low = static_cast<std::int32_t>(value);
  if (low == value) {
    return low;
  }
  return value < 0 ? INT32_MIN : INT32_MAX;
}

constexpr std::int32_t end_of_range(bool negative) { return negative ? INT32_MIN : INT32_MAX; }

// The nearest whole number, or the end of the range. Not inlined: the idle loop has sixty of these.
[[gnu::noinline]] constexpr std::int32_t nearest(float value) {
  if (!(value > -2147483648.0F)) {
    return INT32_MIN;
  }
  if (!(value < 2147483648.0F)) {
    return INT32_MAX;
  }
  return static_cast<std::int32_t>(value + (value < 0.0F ? -0.5F : 0.5F));
}

template <int kFraction>
class Fixed {
  static_assert(kFraction >= 0 && kFraction < 63, "bits behind the point");

 public:
  constexpr Fixed() = default;

  static constexpr Fixed from_raw(std::int32_t raw) {
    Fixed result;
    result.raw_ = raw;
    return result;
  }

  // Nearest, or the end of the range. For constants and the idle loop; the tick has quantity_of().
  static constexpr Fixed of(float value) {
    return from_raw(nearest(value * static_cast<float>(std::int64_t{1} << kFraction)));
  }

  constexpr std::int32_t raw() const { return raw_; }

  constexpr float to_float() const {
    return static_cast<float>(raw_) * (1.0F / static_cast<float>(std::int64_t{1} << kFraction));
  }

  constexpr Fixed half() const { return shifted(1); }
  // Divides by 2 to the power of `bits`, rounded down.
  constexpr Fixed shifted(int bits) const { return from_raw(raw_ >> bits); }

  // By the overflow flag, which takes half the instructions of a sum of 64 bits.
  friend constexpr Fixed operator+(Fixed a, Fixed b) {
    std::int32_t sum = 0;
    const bool overflowed = __builtin_add_overflow(a.raw_, b.raw_, &sum);
    return from_raw(overflowed ? end_of_range(a.raw_ < 0) : sum);
  }

  friend constexpr Fixed operator-(Fixed a, Fixed b) {
    std::int32_t difference = 0;
    const bool overflowed = __builtin_sub_overflow(a.raw_, b.raw_, &difference);
    return from_raw(overflowed ? end_of_range(a.raw_ < 0) : difference);
  }

  friend constexpr Fixed operator-(Fixed a) { return Fixed{} - a; }

  constexpr Fixed& operator+=(Fixed other) { return *this = *this + other; }
  constexpr Fixed& operator-=(Fixed other) { return *this = *this - other; }

  friend constexpr bool operator==(Fixed a, Fixed b) { return a.raw_ == b.raw_; }
  friend constexpr bool operator!=(Fixed a, Fixed b) { return a.raw_ != b.raw_; }
  friend constexpr bool operator<(Fixed a, Fixed b) { return a.raw_ < b.raw_; }
  friend constexpr bool operator>(Fixed a, Fixed b) { return a.raw_ > b.raw_; }
  friend constexpr bool operator<=(Fixed a, Fixed b) { return a.raw_ <= b.raw_; }
  friend constexpr bool operator>=(Fixed a, Fixed b) { return a.raw_ >= b.raw_; }

 private:
  std::int32_t raw_ = 0;
};

// Whatever has a unit of its own: rad, rad/s, rad/s2, V. Up to 128 (7,300 degrees), to 6e-8.
using Quantity = Fixed<24>;
// Factors up to 2048, to 1e-6: gains in V/rad reach 1146.
using Gain = Fixed<20>;
// Factors below 2, to 1e-9: shares, and gains per tick.
using Share = Fixed<30>;
// Angle of an encoder's count: up to 8 rad, to 4e-9.
using PerCount = Fixed<28>;
// Counts, PWM steps, telemetry.
using Whole = Fixed<0>;

// The nearest quantity, by the float's bits: in the tick floats come with commands only.
inline Quantity quantity_of(float value) {
  constexpr std::uint32_t kExponentOfOne = 127;  // exponent of 1.0
  constexpr std::uint32_t kMantissaBits = 23;    // bits of the mantissa behind its leading one
  constexpr std::uint32_t kEqualScale =
      kExponentOfOne + kMantissaBits - 24;  // where mantissa and quantity coincide
  std::uint32_t bits = 0;
  std::memcpy(&bits, &value, sizeof bits);
  const std::uint32_t exponent = (bits >> kMantissaBits) & 0xffU;
  const std::uint32_t mantissa = (bits & 0x7fffffU) | 0x800000U;
  std::uint32_t magnitude_raw = 0;
  if (exponent >= kExponentOfOne + 7U) {
    magnitude_raw = INT32_MAX;
  } else if (exponent >= kEqualScale) {
    magnitude_raw = mantissa << (exponent - kEqualScale);
  } else if (exponent + kMantissaBits + 2U > kEqualScale) {
    const std::uint32_t shift = kEqualScale - exponent;
    magnitude_raw = (mantissa + (1U << (shift - 1U))) >> shift;
  }
  const auto raw = static_cast<std::int32_t>(magnitude_raw);
  return Quantity::from_raw((bits >> 31U) != 0U ? -raw : raw);
}

template <int kA, int kB>
constexpr std::int64_t exact_product(Fixed<kA> a, Fixed<kB> b) {
  return static_cast<std::int64_t>(a.raw()) * b.raw();
}

// Drops the last kBits bits, rounded.
template <int kBits>
constexpr std::int32_t shortened(std::int64_t value) {
  return saturated((value + (std::int64_t{1} << (kBits - 1))) >> kBits);
}

// The product, rounded, with kTo bits behind the point.
template <int kTo, int kA, int kB>
constexpr Fixed<kTo> product(Fixed<kA> a, Fixed<kB> b) {
  constexpr int kShift = kA + kB - kTo;
  static_assert(kShift > 0, "the product has no more bits to give");
  return Fixed<kTo>::from_raw(shortened<kShift>(exact_product(a, b)));
}

// A quantity times a factor is a quantity.
template <int kFactor>
constexpr Quantity operator*(Fixed<kFactor> factor, Quantity quantity) {
  return product<24>(factor, quantity);
}

// The product rounded towards zero: what shrinks again and again becomes zero.
constexpr Quantity shrunk(Quantity quantity, Share keep) {
  const std::int64_t exact = exact_product(quantity, keep);
  const std::int64_t towards_zero = exact < 0 ? (std::int64_t{1} << 30) - 1 : 0;
  return Quantity::from_raw(saturated((exact + towards_zero) >> 30));
}

template <int kFraction>
constexpr Fixed<kFraction> magnitude(Fixed<kFraction> value) {
  return value < Fixed<kFraction>{} ? -value : value;
}

constexpr std::uint64_t long_product(std::uint32_t a, std::uint32_t b) {
  return static_cast<std::uint64_t>(a) * b;
}

// Square root of a whole number below 2^62, to one part in 10^8 or one, whichever is more.
constexpr std::uint32_t square_root(std::uint64_t value) {
  if (value == 0U) {
    return 0U;
  }
  const unsigned shift = static_cast<unsigned>(__builtin_clzll(value)) & ~1U;
  // In [1/4, 1), 32 bits behind the point.
  const auto part = static_cast<std::uint32_t>((value << shift) >> 32U);
  // 1 / sqrt(part), 30 bits behind the point: the line 2.2 - 1.26 part is right to 12 %, and each
  // step of Newton's method makes 1.5 e^2 of an error of e.
  std::uint32_t inverse =
      2362232013U - static_cast<std::uint32_t>(long_product(part, 1352914698U) >> 32U);
  for (int step = 0; step < 4; ++step) {
    const auto square = static_cast<std::uint32_t>(long_product(inverse, inverse) >> 31U);
    const auto ratio = static_cast<std::uint32_t>(long_product(part, square) >> 32U);
    constexpr std::uint32_t kThree = 3U << 29U;
    inverse = static_cast<std::uint32_t>(long_product(inverse, kThree - ratio) >> 30U);
  }
  const auto root = static_cast<std::uint32_t>(long_product(part, inverse) >> 31U);
  return root >> (shift / 2U - 1U);
}

}  // namespace heli::control
