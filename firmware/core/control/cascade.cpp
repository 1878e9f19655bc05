// One step of the cascade and its changes between open and closed loops; see cascade.hpp.
// update(), shadow() and what they call run in the tick; derive() runs in the idle loop.
#include "control/cascade.hpp"

#include "control/loop.hpp"
#include "control/math.hpp"
#include "link/declaration.hpp"

namespace heli::control {

namespace axes = link::axes;

// The parameters (V/deg, deg, 1/s) become constants per tick in rad and fixed point.

namespace {

using link::Param;

// `ki` is per second. Units as in PidGains, with the loop's output.
PidGains gains_of(float kp, float ki, float kd, float integral_max) {
  return {Gain::of(kp), Share::of(ki * kTick_s), Gain::of(kd), Quantity::of(integral_max)};
}

}  // namespace

CascadeConstants cascade_constants_of(const params::Params& params) {
  CascadeConstants c{};
  const auto volts = [&params](Param p) { return Quantity::of(params.get(p)); };
  // The parameter is in V/deg (V per deg/s, V per deg/s2); the result is in V/rad.
  const auto volts_per_deg = [&params](Param p) { return params.get(p) * kDegPerRad; };
  c.elevation =
      gains_of(volts_per_deg(Param::elevation_kp), volts_per_deg(Param::elevation_ki),
               volts_per_deg(Param::elevation_kd), params.get(Param::elevation_integral_max_V));
  c.pitch = gains_of(volts_per_deg(Param::pitch_kp), volts_per_deg(Param::pitch_ki),
                     volts_per_deg(Param::pitch_kd), params.get(Param::pitch_integral_max_V));
  c.travel = gains_of(params.get(Param::travel_kp), params.get(Param::travel_ki),
                      params.get(Param::travel_kd),
                      params.get(Param::travel_integral_max_deg) * kRadPerDeg);
  c.hover_V = volts(Param::hover_V);
  c.hover_V_per_rad = Gain::of(volts_per_deg(Param::hover_slope));
  c.pitch_hold_V_per_rad = Gain::of(volts_per_deg(Param::pitch_hold_ff));
  c.elevation_rate_ff = Share::of(params.get(Param::elevation_rate_ff));
  c.travel_rate_ff = Share::of(params.get(Param::travel_rate_ff));
  c.elevation_acceleration_ff = Gain::of(volts_per_deg(Param::elevation_acceleration_ff));
  c.travel_acceleration_ff = Gain::of(params.get(Param::travel_acceleration_ff));
  c.pitch_setpoint_max_rad = Quantity::of(params.get(Param::pitch_setpoint_max_deg) * kRadPerDeg);
  c.pitch_step_max_rad = Quantity::of(params.get(Param::pitch_slew_deg_s) * kRadPerDeg * kTick_s);
  c.bumpless_keep = bumpless_keep_of(params);

  c.dead_zone = DeadZone::of(params.get(Param::dead_zone_V));
  c.motor_min_V = volts(Param::motor_min_V);
  c.motor_max_V = volts(Param::motor_max_V);
  c.mixer = MixerLimits::of(lift_from_motor_V(c.motor_min_V, c.dead_zone),
                            lift_from_motor_V(c.motor_max_V, c.dead_zone),
                            volts(Param::differential_max_V));
  return c;
}

void Cascade::derive(IdleLoop, const params::Params& params, Bank bank) {
  constants_[bank] = cascade_constants_of(params);
}

void Cascade::shadow(const ControlInput& in, Bank bank, const ControlOutput& acting) {
  const CascadeConstants& c = constants_[bank];
  const Pid elevation = state_.elevation;
  const Pid pitch = state_.pitch;
  const Pid travel = state_.travel;
  // A step keeps the rest of the state up to date; its integrators are restored.
  step(in, c);
  state_.elevation = elevation;
  state_.pitch = pitch;
  state_.travel = travel;
  // The state becomes that of a cascade which had commanded the law's voltages.
  state_.front_V = acting.front_V - in.excitation_front_V;
  state_.back_V = acting.back_V - in.excitation_back_V;
  const Quantity front_V = lift_from_motor_V(state_.front_V, c.dead_zone);
  const Quantity back_V = lift_from_motor_V(state_.back_V, c.dead_zone);
  state_.collective_fade.shift(front_V + back_V - state_.collective_V);
  state_.differential_fade.shift(front_V - back_V - state_.differential_V);
  state_.collective_V = front_V + back_V;
  state_.differential_V = front_V - back_V;
}

ControlOutput Cascade::step(const ControlInput& in, const CascadeConstants& c) {
  const std::uint8_t changed_axes = state_.started
                                        ? static_cast<std::uint8_t>(in.axes ^ state_.axes)
                                        : static_cast<std::uint8_t>(0xffU);
  const auto newly_closed = static_cast<std::uint8_t>(in.axes & changed_axes);
  state_.axes = in.axes;
  state_.started = true;
  if ((in.axes & (axes::elevation | axes::pitch)) == 0U) {
    return all_open(in, c, changed_axes != 0U);
  }

  // A loop that closes starts with its integral at zero.
  if ((newly_closed & axes::elevation) != 0U) {
    state_.elevation.reset();
  }
  if ((newly_closed & axes::pitch) != 0U) {
    state_.pitch.reset();
    state_.pitch_setpoint_rad = in.angle_rad[kPitch];
  }
  if ((newly_closed & axes::travel) != 0U) {
    state_.travel.reset();
  }

  const Quantity pitch_setpoint_rad =
      follow_pitch_setpoint(in, c, (changed_axes & (axes::travel | axes::pitch)) != 0U);
  const Quantity pitch_error_rad = pitch_setpoint_rad - in.angle_rad[kPitch];
  const Quantity elevation_error_rad = in.setpoint_rad[kElevation] - in.angle_rad[kElevation];

  // Elevation commands the sum of the voltages, pitch their difference; for an open axis they are
  // those that the host commands. When a loop closes or opens, its voltage changes gradually.
  const Quantity open_front_V = lift_from_motor_V(in.open_front_V, c.dead_zone);
  const Quantity open_back_V = lift_from_motor_V(in.open_back_V, c.dead_zone);
  const bool elevation_closed = (in.axes & axes::elevation) != 0U;
  const bool pitch_closed = (in.axes & axes::pitch) != 0U;
  const Quantity collective_V = state_.collective_fade.apply(
      elevation_closed ? lift_for_elevation(in, c, elevation_error_rad)
                       : open_front_V + open_back_V,
      state_.collective_V, (changed_axes & axes::elevation) != 0U, c.bumpless_keep);
  const Quantity differential_V = state_.differential_fade.apply(
      pitch_closed ? c.pitch_hold_V_per_rad * pitch_setpoint_rad +
                         state_.pitch.output(c.pitch, pitch_error_rad, in.rate_rad_s[kPitch])
                   : open_front_V - open_back_V,
      state_.differential_V, (changed_axes & axes::pitch) != 0U, c.bumpless_keep);

  // The mixer limits both to what the motors can do. The state does not contain the excitation, so
  // that a change-over starts from the voltages of the loops alone.
  const Quantity excitation_sum_V = in.excitation_front_V + in.excitation_back_V;
  const Quantity excitation_difference_V = in.excitation_front_V - in.excitation_back_V;
  const Quantity requested_collective_V = collective_V + excitation_sum_V;
  const Quantity requested_differential_V = differential_V + excitation_difference_V;
  const Mixed mixed = mix(requested_collective_V, requested_differential_V, c.mixer);
  state_.collective_V = mixed.collective_V - excitation_sum_V;
  state_.differential_V = mixed.differential_V - excitation_difference_V;

  // The part beyond the motors' limits stops the integrators from winding up.
  const Quantity collective_excess_V = requested_collective_V - mixed.collective_V;
  const Quantity differential_excess_V = requested_differential_V - mixed.differential_V;
  if (elevation_closed) {
    state_.elevation.integrate(c.elevation, elevation_error_rad, collective_excess_V);
  }
  if (pitch_closed) {
    state_.pitch.integrate(c.pitch, pitch_error_rad, differential_excess_V);
  }
  if ((in.axes & axes::travel) != 0U && !in.travel_waits) {
    // The travel loop must not wind up at the limit of the mixer or of the pitch setpoint.
    const Quantity excess = state_.pitch_setpoint_excess_rad != Quantity{}
                                ? state_.pitch_setpoint_excess_rad
                                : differential_excess_V;
    state_.travel.integrate(c.travel, in.setpoint_rad[kTravel] - in.angle_rad[kTravel], excess);
  }

  // Lift volts to motor volts, and what the telemetry flags report.
  state_.front_V =
      clamp(motor_from_lift_V(mixed.front_V, c.dead_zone), c.motor_min_V, c.motor_max_V);
  state_.back_V = clamp(motor_from_lift_V(mixed.back_V, c.dead_zone), c.motor_min_V, c.motor_max_V);
  ControlOutput out{};
  out.front_V = state_.front_V;
  out.back_V = state_.back_V;
  out.pitch_setpoint_rad = pitch_setpoint_rad;
  out.front_saturated = collective_excess_V + differential_excess_V != Quantity{};
  out.back_saturated = collective_excess_V != differential_excess_V;
  out.pitch_limited = state_.pitch_setpoint_excess_rad != Quantity{};
  return out;
}

// Collective lift volts (front + back) of the elevation loop: feedforward and PID, eq. (33).
Quantity Cascade::lift_for_elevation(const ControlInput& in, const CascadeConstants& c,
                                     Quantity error_rad) const {
  const Quantity rate_error_rad_s =
      in.rate_rad_s[kElevation] - c.elevation_rate_ff * in.setpoint_rate_rad_s[kElevation];
  return c.hover_V + c.hover_V_per_rad * in.setpoint_rad[kElevation] +
         c.elevation_acceleration_ff * in.setpoint_acceleration_rad_s2[kElevation] +
         state_.elevation.output(c.elevation, error_rad, rate_error_rad_s);
}

// Pitch setpoint in rad of the travel loop: feedforward and PID, eq. (34).
Quantity Cascade::pitch_for_travel(const ControlInput& in, const CascadeConstants& c) const {
  const Quantity rate_error_rad_s =
      in.rate_rad_s[kTravel] - c.travel_rate_ff * in.setpoint_rate_rad_s[kTravel];
  return c.travel_acceleration_ff * in.setpoint_acceleration_rad_s2[kTravel] +
         state_.travel.output(c.travel, in.setpoint_rad[kTravel] - in.angle_rad[kTravel],
                              rate_error_rad_s);
}

// Without any closed loop the motors get the caller's voltages, to which no dead zone is added:
// identification of the thrust curve needs the actual volts.
ControlOutput Cascade::all_open(const ControlInput& in, const CascadeConstants& c,
                                bool axes_changed) {
  state_.front_V =
      state_.front_fade.apply(in.open_front_V, state_.front_V, axes_changed, c.bumpless_keep);
  state_.back_V =
      state_.back_fade.apply(in.open_back_V, state_.back_V, axes_changed, c.bumpless_keep);
  const Quantity front_V = state_.front_V + in.excitation_front_V;
  const Quantity back_V = state_.back_V + in.excitation_back_V;
  ControlOutput out{};
  out.front_V = clamp(front_V, c.motor_min_V, c.motor_max_V);
  out.back_V = clamp(back_V, c.motor_min_V, c.motor_max_V);
  out.front_saturated = out.front_V != front_V;
  out.back_saturated = out.back_V != back_V;
  out.pitch_setpoint_rad = in.setpoint_rad[kPitch];
  const Quantity front_lift_V = lift_from_motor_V(state_.front_V, c.dead_zone);
  const Quantity back_lift_V = lift_from_motor_V(state_.back_V, c.dead_zone);
  state_.collective_V = front_lift_V + back_lift_V;
  state_.differential_V = front_lift_V - back_lift_V;
  return out;
}

// The pitch setpoint of this tick: the travel loop's or the caller's, with a gradual change between
// the two, limited in size and slew. The part beyond the limits stops the travel integrator.
Quantity Cascade::follow_pitch_setpoint(const ControlInput& in, const CascadeConstants& c,
                                        bool axes_changed) {
  const bool travel_closed = (in.axes & axes::travel) != 0U && !in.travel_waits;
  const bool transfer_needed = axes_changed || in.travel_waits != state_.travel_waits;
  state_.travel_waits = in.travel_waits;
  const Quantity requested_rad = state_.pitch_setpoint_fade.apply(
      travel_closed ? pitch_for_travel(in, c) : in.setpoint_rad[kPitch], state_.pitch_setpoint_rad,
      transfer_needed, c.bumpless_keep);
  const Quantity limited_rad =
      clamp(requested_rad, -c.pitch_setpoint_max_rad, c.pitch_setpoint_max_rad);
  state_.pitch_setpoint_rad = clamp(limited_rad, state_.pitch_setpoint_rad - c.pitch_step_max_rad,
                                    state_.pitch_setpoint_rad + c.pitch_step_max_rad);
  state_.pitch_setpoint_excess_rad = requested_rad - state_.pitch_setpoint_rad;
  return state_.pitch_setpoint_rad;
}

}  // namespace heli::control
