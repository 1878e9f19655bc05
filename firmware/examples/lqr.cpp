// The control law and its constants; lqr.hpp describes the controller.
#include "control/lqr.hpp"

#include "control/math.hpp"

namespace heli::control {

namespace {

// For the rig makki2024, from python-control's lqr() with the linear model of
// heli_lab.control.tune.loops.linear_plant and the weights of README.md.
constexpr Gain kElevation_V_per_rad = Gain::of(8.94F);
constexpr Gain kElevation_V_per_rad_s = Gain::of(6.70F);
constexpr Gain kPitch_V_per_rad = Gain::of(1.01F);
constexpr Gain kPitch_V_per_rad_s = Gain::of(0.693F);
constexpr Gain kTravel_V_per_rad = Gain::of(1.73F);
constexpr Gain kTravel_V_per_rad_s = Gain::of(4.59F);

}  // namespace

void Lqr::derive(IdleLoop, const params::Params& params, Bank bank) {
  using link::Param;
  Constants& c = constants_[bank];
  c.hover_V = Quantity::of(params.get(Param::hover_V));
  c.hover_V_per_rad = Gain::of(params.get(Param::hover_slope) * kDegPerRad);
  c.pitch_hold_V_per_rad = Gain::of(params.get(Param::pitch_hold_ff) * kDegPerRad);
  c.dead_zone = DeadZone::of(params.get(Param::dead_zone_V));
  c.motor_min_V = Quantity::of(params.get(Param::motor_min_V));
  c.motor_max_V = Quantity::of(params.get(Param::motor_max_V));
  c.mixer = MixerLimits::of(lift_from_motor_V(c.motor_min_V, c.dead_zone),
                            lift_from_motor_V(c.motor_max_V, c.dead_zone),
                            Quantity::of(params.get(Param::differential_max_V)));
  c.bumpless_keep = bumpless_keep_of(params);
}

void Lqr::init() {
  front_V_ = {};
  back_V_ = {};
  begins_ = true;
}

ControlOutput Lqr::update(const ControlInput& in, Bank bank) {
  const Constants& c = constants_[bank];
  const bool changed = begins_ || in.axes != axes_ || in.travel_waits != travel_waits_;
  begins_ = false;
  axes_ = in.axes;
  travel_waits_ = in.travel_waits;

  // What no loop closes follows the caller: in open loop both voltages are the caller's.
  const bool elevation_closed = (in.axes & link::axes::elevation) != 0U;
  const bool pitch_closed = (in.axes & link::axes::pitch) != 0U;
  // While travel waits, pitch goes to the setpoint of the check of the travel encoder.
  const bool travel_closed = (in.axes & link::axes::travel) != 0U && !in.travel_waits;
  Quantity front_V = in.open_front_V;
  Quantity back_V = in.open_back_V;
  bool saturated = false;
  if (elevation_closed || pitch_closed) {
    const Quantity open_front_V = lift_from_motor_V(in.open_front_V, c.dead_zone);
    const Quantity open_back_V = lift_from_motor_V(in.open_back_V, c.dead_zone);
    Quantity collective_V = open_front_V + open_back_V;
    Quantity differential_V = open_front_V - open_back_V;
    if (elevation_closed) {
      collective_V =
          c.hover_V + c.hover_V_per_rad * in.setpoint_rad[kElevation] +
          kElevation_V_per_rad * (in.setpoint_rad[kElevation] - in.angle_rad[kElevation]) -
          kElevation_V_per_rad_s * (in.rate_rad_s[kElevation] - in.setpoint_rate_rad_s[kElevation]);
    }
    if (pitch_closed) {
      const Quantity wanted_rad = travel_closed ? Quantity{} : in.setpoint_rad[kPitch];
      differential_V = c.pitch_hold_V_per_rad * wanted_rad +
                       kPitch_V_per_rad * (wanted_rad - in.angle_rad[kPitch]) -
                       kPitch_V_per_rad_s * in.rate_rad_s[kPitch];
    }
    if (travel_closed) {
      differential_V +=
          kTravel_V_per_rad * (in.setpoint_rad[kTravel] - in.angle_rad[kTravel]) -
          kTravel_V_per_rad_s * (in.rate_rad_s[kTravel] - in.setpoint_rate_rad_s[kTravel]);
    }
    const Mixed mixed = mix(collective_V, differential_V, c.mixer);
    saturated = mixed.collective_V != collective_V || mixed.differential_V != differential_V;
    front_V = motor_from_lift_V(mixed.front_V, c.dead_zone);
    back_V = motor_from_lift_V(mixed.back_V, c.dead_zone);
  }

  front_V_ = clamp(front_.apply(front_V, front_V_, changed, c.bumpless_keep), c.motor_min_V,
                   c.motor_max_V);
  back_V_ =
      clamp(back_.apply(back_V, back_V_, changed, c.bumpless_keep), c.motor_min_V, c.motor_max_V);
  ControlOutput out{};
  out.front_V = clamp(front_V_ + in.excitation_front_V, c.motor_min_V, c.motor_max_V);
  out.back_V = clamp(back_V_ + in.excitation_back_V, c.motor_min_V, c.motor_max_V);
  out.pitch_setpoint_rad = travel_closed ? Quantity{} : in.setpoint_rad[kPitch];
  out.front_saturated = saturated;
  out.back_saturated = saturated;
  return out;
}

void Lqr::shadow(const ControlInput& in, Bank, const ControlOutput& acting) {
  front_V_ = acting.front_V - in.excitation_front_V;
  back_V_ = acting.back_V - in.excitation_back_V;
  axes_ = in.axes;
  begins_ = true;
}

void Lqr::take_over() {
  front_.clear();
  back_.clear();
  begins_ = false;
}

}  // namespace heli::control
