// Derives the conversion constants from the parameters; runs in the idle loop. See conversion.hpp.
#include "conversion.hpp"

#include "control/math.hpp"

namespace heli {

using control::clamp;
using control::Gain;
using control::kPi;
using control::kTick_s;
using control::PerCount;
using control::product;
using control::Quantity;
using control::Share;
using link::Param;

namespace {

// `sign` is 1 or -1: the direction in which the motor is wired. The limits become duties in order.
MotorConversion motor_conversion_of(const params::Params& params, float sign,
                                    std::int16_t duty_full) {
  const float V_per_duty = params.get(Param::supply_V) / static_cast<float>(duty_full);
  MotorConversion motor{};
  motor.duty_per_V = Gain::of(sign / V_per_duty);
  motor.V_per_duty = Share::of(V_per_duty / sign);
  const auto duty_at = [&](Param limit) {
    const Quantity limit_V = Quantity::of(params.get(limit));
    const std::int32_t full = duty_full;
    return clamp(product<0>(limit_V, motor.duty_per_V).raw(), -full, full);
  };
  const std::int32_t at_min = duty_at(Param::motor_min_V);
  const std::int32_t at_max = duty_at(Param::motor_max_V);
  motor.min_duty = at_min < at_max ? at_min : at_max;
  motor.max_duty = at_min < at_max ? at_max : at_min;
  return motor;
}

}  // namespace

float smoothing_of(float cutoff_Hz) {
  return control::one_minus_exp(2.0F * kPi * cutoff_Hz * kTick_s);
}

Conversion conversion_of(const params::Params& params, std::int16_t duty_full) {
  Conversion c{};
  const Param counts[kAxisCount] = {Param::elevation_counts_per_rev, Param::pitch_counts_per_rev,
                                    Param::travel_counts_per_rev};
  const Param cutoffs[kAxisCount] = {Param::elevation_filter_Hz, Param::pitch_filter_Hz,
                                     Param::travel_filter_Hz};
  for (std::size_t axis = 0; axis < kAxisCount; ++axis) {
    const float per_rev = params.get(counts[axis]);
    c.count_sign[axis] = per_rev < 0.0F ? -1 : 1;
    c.rad_per_count[axis] = PerCount::of(2.0F * kPi / control::magnitude(per_rev));
    c.smoothing[axis] = Share::of(smoothing_of(params.get(cutoffs[axis])));
  }
  c.elevation_rest_counts =
      control::round_to_int(params.get(Param::elevation_rest_deg) / 360.0F *
                            control::magnitude(params.get(Param::elevation_counts_per_rev)));
  c.front = motor_conversion_of(params, params.get(Param::motor_front_sign), duty_full);
  c.back = motor_conversion_of(params, params.get(Param::motor_back_sign), duty_full);
  return c;
}

}  // namespace heli
