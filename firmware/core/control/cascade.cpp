#include "control/cascade.hpp"

#include "link/declaration.hpp"

namespace heli::control {

namespace axes = link::axes;

ControlOutput Cascade::update(const ControlInput& in, const Constants& c) {
  const std::uint8_t changed =
      started_ ? static_cast<std::uint8_t>(in.axes ^ axes_) : static_cast<std::uint8_t>(0xffU);
  const auto closing = static_cast<std::uint8_t>(in.axes & changed);
  axes_ = in.axes;
  started_ = true;
  if ((in.axes & (axes::elevation | axes::pitch)) == 0U) {
    return all_open(in, c, changed != 0U);
  }

  if ((closing & axes::elevation) != 0U) {
    elevation_.reset();
  }
  if ((closing & axes::pitch) != 0U) {
    pitch_.reset();
    pitch_setpoint_rad_ = in.angle_rad[kPitch];
  }
  if ((closing & axes::travel) != 0U) {
    travel_.reset();
  }

  const Quantity pitch_setpoint_rad =
      follow_pitch_setpoint(in, c, (changed & (axes::travel | axes::pitch)) != 0U);
  const Quantity pitch_error_rad = pitch_setpoint_rad - in.angle_rad[kPitch];
  const Quantity elevation_error_rad = in.setpoint_rad[kElevation] - in.angle_rad[kElevation];

  const Quantity open_front_V = lift_from_motor_V(in.open_front_V, c.dead_zone);
  const Quantity open_back_V = lift_from_motor_V(in.open_back_V, c.dead_zone);
  const bool elevation_closed = (in.axes & axes::elevation) != 0U;
  const bool pitch_closed = (in.axes & axes::pitch) != 0U;
  const Quantity collective_V =
      collective_fade_.apply(elevation_closed ? lift_for_elevation(in, c, elevation_error_rad)
                                              : open_front_V + open_back_V,
                             collective_V_, (changed & axes::elevation) != 0U, c.bumpless_keep);
  const Quantity differential_V = differential_fade_.apply(
      pitch_closed ? c.pitch_hold_V_per_rad * pitch_setpoint_rad +
                         pitch_.output(c.pitch, pitch_error_rad, in.rate_rad_s[kPitch])
                   : open_front_V - open_back_V,
      differential_V_, (changed & axes::pitch) != 0U, c.bumpless_keep);

  const Quantity excitation_sum_V = in.excitation_front_V + in.excitation_back_V;
  const Quantity excitation_difference_V = in.excitation_front_V - in.excitation_back_V;
  const Quantity wanted_collective_V = collective_V + excitation_sum_V;
  const Quantity wanted_differential_V = differential_V + excitation_difference_V;
  const Mixed mixed = mix(wanted_collective_V, wanted_differential_V, c.mixer);
  collective_V_ = mixed.collective_V - excitation_sum_V;
  differential_V_ = mixed.differential_V - excitation_difference_V;

  const Quantity collective_excess_V = wanted_collective_V - mixed.collective_V;
  const Quantity differential_excess_V = wanted_differential_V - mixed.differential_V;
  if (elevation_closed) {
    elevation_.integrate(c.elevation, elevation_error_rad, collective_excess_V);
  }
  if (pitch_closed) {
    pitch_.integrate(c.pitch, pitch_error_rad, differential_excess_V);
  }
  if ((in.axes & axes::travel) != 0U) {
    // Asking for more pitch is as useless when the mixer is at its limit as when the setpoint is.
    const Quantity excess = pitch_setpoint_excess_rad_ != Quantity{} ? pitch_setpoint_excess_rad_
                                                                     : differential_excess_V;
    travel_.integrate(c.travel, in.setpoint_rad[kTravel] - in.angle_rad[kTravel], excess);
  }

  front_V_ = clamp(motor_from_lift_V(mixed.front_V, c.dead_zone), c.motor_min_V, c.motor_max_V);
  back_V_ = clamp(motor_from_lift_V(mixed.back_V, c.dead_zone), c.motor_min_V, c.motor_max_V);
  ControlOutput out{};
  out.front_V = front_V_;
  out.back_V = back_V_;
  out.pitch_setpoint_rad = pitch_setpoint_rad;
  out.front_saturated = collective_excess_V + differential_excess_V != Quantity{};
  out.back_saturated = collective_excess_V != differential_excess_V;
  out.pitch_limited = pitch_setpoint_excess_rad_ != Quantity{};
  return out;
}

Quantity Cascade::lift_for_elevation(const ControlInput& in, const Constants& c,
                                     Quantity error_rad) const {
  const Quantity braked_rad_s =
      in.rate_rad_s[kElevation] - c.elevation_rate_ff * in.setpoint_rate_rad_s[kElevation];
  return c.hover_V + c.hover_V_per_rad * in.setpoint_rad[kElevation] +
         c.elevation_acceleration_ff * in.setpoint_acceleration_rad_s2[kElevation] +
         elevation_.output(c.elevation, error_rad, braked_rad_s);
}

Quantity Cascade::pitch_for_travel(const ControlInput& in, const Constants& c) const {
  const Quantity braked_rad_s =
      in.rate_rad_s[kTravel] - c.travel_rate_ff * in.setpoint_rate_rad_s[kTravel];
  return c.travel_acceleration_ff * in.setpoint_acceleration_rad_s2[kTravel] +
         travel_.output(c.travel, in.setpoint_rad[kTravel] - in.angle_rad[kTravel], braked_rad_s);
}

// Without any closed loop the voltages are the caller's own, dead zone included: identification of
// the thrust curve needs volts that mean what they say.
ControlOutput Cascade::all_open(const ControlInput& in, const Constants& c, bool changed) {
  front_V_ = front_fade_.apply(in.open_front_V, front_V_, changed, c.bumpless_keep);
  back_V_ = back_fade_.apply(in.open_back_V, back_V_, changed, c.bumpless_keep);
  const Quantity front_V = front_V_ + in.excitation_front_V;
  const Quantity back_V = back_V_ + in.excitation_back_V;
  ControlOutput out{};
  out.front_V = clamp(front_V, c.motor_min_V, c.motor_max_V);
  out.back_V = clamp(back_V, c.motor_min_V, c.motor_max_V);
  out.front_saturated = out.front_V != front_V;
  out.back_saturated = out.back_V != back_V;
  out.pitch_setpoint_rad = in.setpoint_rad[kPitch];
  const Quantity front_lift_V = lift_from_motor_V(front_V_, c.dead_zone);
  const Quantity back_lift_V = lift_from_motor_V(back_V_, c.dead_zone);
  collective_V_ = front_lift_V + back_lift_V;
  differential_V_ = front_lift_V - back_lift_V;
  return out;
}

Quantity Cascade::follow_pitch_setpoint(const ControlInput& in, const Constants& c, bool changed) {
  const bool travel_closed = (in.axes & axes::travel) != 0U;
  const Quantity wanted_rad =
      pitch_setpoint_fade_.apply(travel_closed ? pitch_for_travel(in, c) : in.setpoint_rad[kPitch],
                                 pitch_setpoint_rad_, changed, c.bumpless_keep);
  const Quantity limited_rad =
      clamp(wanted_rad, -c.pitch_setpoint_max_rad, c.pitch_setpoint_max_rad);
  pitch_setpoint_rad_ = clamp(limited_rad, pitch_setpoint_rad_ - c.pitch_step_max_rad,
                              pitch_setpoint_rad_ + c.pitch_step_max_rad);
  pitch_setpoint_excess_rad_ = wanted_rad - pitch_setpoint_rad_;
  return pitch_setpoint_rad_;
}

}  // namespace heli::control
