// Conversion between a board's counts and the units of the flight code. The constants are derived
// from the parameters each time that one changes.
#pragma once

#include <cstdint>

#include "board.hpp"
#include "control/fixed.hpp"
#include "control/math.hpp"
#include "params/params.hpp"

namespace heli {

// A duty is a signed number of PWM steps; duty_full() steps are the whole supply.
struct MotorConversion {
  control::Gain duty_per_V;   // signed: a motor may be wired the other way round
  control::Share V_per_duty;  // signed
  // The motors' limits as duties, at most full duty: no law can exceed them.
  std::int32_t min_duty = 0;
  std::int32_t max_duty = 0;
};

struct Conversion {
  control::PerCount rad_per_count[kAxisCount];
  std::int32_t count_sign[kAxisCount] = {};
  std::int32_t elevation_rest_counts = 0;  // count of the rest angle, where the encoder is zeroed
  control::Share smoothing[kAxisCount];    // of the rate filters
  MotorConversion front;
  MotorConversion back;
};

// Smoothing of a low-pass per tick: 1 - exp(-2 pi f T). Idle loop only: it uses an exponential.
float smoothing_of(float cutoff_Hz);

// Idle loop only: it uses floats and divisions. `duty_full` is the board's, see Board::duty_full().
Conversion conversion_of(const params::Params& params, std::int16_t duty_full);

// Returns the duty of a motor voltage, within the motor's limits.
inline std::int16_t duty_of(control::Quantity voltage_V, const MotorConversion& motor) {
  const std::int32_t duty = control::product<0>(voltage_V, motor.duty_per_V).raw();
  return static_cast<std::int16_t>(control::clamp(duty, motor.min_duty, motor.max_duty));
}

inline MotorCommand motor_command(bool enable, control::Quantity front_V, control::Quantity back_V,
                                  const Conversion& conversion) {
  if (!enable) {
    return {};
  }
  return {duty_of(front_V, conversion.front), duty_of(back_V, conversion.back), true};
}

}  // namespace heli
