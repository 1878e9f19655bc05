// Constants and small functions of the tick and of the idle loop.
#pragma once

#include <cstdint>
#include <cstring>

namespace heli::control {

inline constexpr float kPi = 3.14159265358979F;
inline constexpr float kRadPerDeg = kPi / 180.0F;
inline constexpr float kDegPerRad = 180.0F / kPi;
inline constexpr float kTick_s = 0.001F;
inline constexpr float kTickRate_Hz = 1000.0F;

// Converts a time that is not negative to the nearest tick.
inline std::uint32_t ticks_of(float seconds) {
  return static_cast<std::uint32_t>(seconds * kTickRate_Hz + 0.5F);
}

template <class Number>
constexpr Number clamp(Number value, Number min, Number max) {
  return value < min ? min : (value > max ? max : value);
}

constexpr float magnitude(float value) { return value < 0.0F ? -value : value; }

// Nearest whole number; halves away from zero.
inline std::int32_t round_to_int(float value) {
  std::uint32_t bits = 0;
  std::memcpy(&bits, &value, sizeof bits);
  // 2^31 and beyond, infinity and NaN: to cast these is undefined, so the ends replace them.
  if ((bits & 0x7fffffffU) >= 0x4f000000U) {
    return (bits >> 31U) != 0U ? INT32_MIN : INT32_MAX;
  }
  return static_cast<std::int32_t>(value + (value < 0.0F ? -0.5F : 0.5F));
}

// 1 - exp(-x) by its series, for x up to 1.3; divides, so for the idle loop. Every C library rounds
// its exp in its own way, and by that alone the emulated Due flew one count away from the same code
// on a PC.
inline float one_minus_exp(float x) {
  float sum = 1.0F;
  for (int n = 14; n > 1; --n) {
    sum = 1.0F - x / static_cast<float>(n) * sum;
  }
  return x * sum;
}

// 1 / value for positive normal numbers, to a few units in the last place. Soft-float division
// costs 149 instructions on the Due against 33 for a multiplication, and its time varies.
// Subtracting the bits from a constant negates the exponent, which is right to 5.1 % (evaluated).
// Each of the three steps of Newton's method then squares the relative error.
inline float reciprocal(float value) {
  std::uint32_t bits = 0;
  std::memcpy(&bits, &value, sizeof bits);
  bits = 0x7ef311c7U - bits;  // about twice the bits of 1.0F
  float guess = 0.0F;
  std::memcpy(&guess, &bits, sizeof guess);
  guess *= 2.0F - value * guess;
  guess *= 2.0F - value * guess;
  guess *= 2.0F - value * guess;
  return guess;
}

}  // namespace heli::control
