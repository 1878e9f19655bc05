// Between what a board counts and the units of the flight code: what the core itself needs of the
// parameters, worked out once for each change of one.
#pragma once

#include <cstdint>

#include "board.hpp"
#include "control/fixed.hpp"
#include "params/params.hpp"

namespace heli {

struct MotorConversion {
  control::Gain duty_per_V;   // signed: a motor may be wired the other way round
  control::Share V_per_duty;  // signed
  // The motors' limits as duties, within full duty: no law gets beyond them.
  std::int32_t min_duty = 0;
  std::int32_t max_duty = 0;
};

struct Conversion {
  control::PerCount rad_per_count[kAxisCount];
  std::int32_t count_sign[kAxisCount] = {};
  std::int32_t elevation_rest_counts = 0;
  control::Share smoothing[kAxisCount];  // of the rate filters
  MotorConversion front;
  MotorConversion back;
};

// Uses floats, divisions and exponentials: idle loop only. `duty_full` is the board's.
// Of a low-pass, for each tick: 1 - exp(-2 pi f T).
float smoothing_of(float cutoff_Hz);

Conversion conversion_of(const params::Params& params, std::int16_t duty_full);

}  // namespace heli
