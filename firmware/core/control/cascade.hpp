// The cascade of PID loops of the paper, and its constants, which follow from the parameters.
#pragma once

#include "control/controller.hpp"
#include "control/fixed.hpp"
#include "control/loop.hpp"
#include "control/mixer.hpp"
#include "params/params.hpp"

// Constants of the cascade, derived from the parameters each time that one changes.
namespace heli::control {

struct CascadeConstants {
  PidGains elevation;              // output: collective lift volts
  PidGains pitch;                  // output: differential lift volts
  PidGains travel;                 // output: pitch setpoint in rad
  Quantity hover_V;                // collective lift volts that carry the level arm
  Gain hover_V_per_rad;            // their change with elevation
  Gain pitch_hold_V_per_rad;       // differential lift volts that hold a pitch
  Share elevation_rate_ff;         // share of the setpoint's rate that the D term does not brake
  Share travel_rate_ff;            // likewise
  Gain elevation_acceleration_ff;  // V per rad/s2
  Gain travel_acceleration_ff;     // rad per rad/s2
  Quantity pitch_setpoint_max_rad;
  Quantity pitch_step_max_rad;  // per tick
  Share bumpless_keep;          // share of a jump that remains after one tick

  DeadZone dead_zone;
  MixerLimits mixer;
  Quantity motor_min_V;
  Quantity motor_max_V;
};

// Uses floats, divisions and exponentials: idle loop only.
CascadeConstants cascade_constants_of(const params::Params& params);

// The paper's control law: travel -> pitch setpoint -> differential voltage; elevation ->
// collective voltage (eqs. 32-34), with limits, anti-windup and smooth changes.

class Cascade final : public Controller {
 public:
  void derive(IdleLoop, const params::Params& params, Bank bank) override;
  void init() override { state_ = {}; }
  ControlOutput update(const ControlInput& in, Bank bank) override {
    return step(in, constants_[bank]);
  }

  // The integrators keep their values, which suit this rig; they do not integrate the errors of the
  // uploaded law.
  void shadow(const ControlInput& in, Bank bank, const ControlOutput& acting) override;

  void take_over() override {
    state_.collective_fade.clear();
    state_.differential_fade.clear();
    state_.pitch_setpoint_fade.clear();
  }

 private:
  struct State {
    Pid elevation;
    Pid pitch;
    Pid travel;
    BumplessTransfer collective_fade;
    BumplessTransfer differential_fade;
    BumplessTransfer pitch_setpoint_fade;
    BumplessTransfer front_fade;
    BumplessTransfer back_fade;
    std::uint8_t axes = 0;
    bool started = false;
    bool travel_waits = false;
    Quantity front_V;  // motor volts of the previous tick, without excitation
    Quantity back_V;
    Quantity collective_V;  // lift volts achieved in the previous tick, without excitation
    Quantity differential_V;
    Quantity pitch_setpoint_rad;
    Quantity pitch_setpoint_excess_rad;
  };

  // Not inlined: GCC 12 would compute the bank's address again at many uses of a constant, which
  // costs 39 instructions more on the Due.
  [[gnu::noinline]] ControlOutput step(const ControlInput& in, const CascadeConstants& c);
  ControlOutput all_open(const ControlInput& in, const CascadeConstants& c, bool axes_changed);
  Quantity lift_for_elevation(const ControlInput& in, const CascadeConstants& c,
                              Quantity error_rad) const;
  Quantity pitch_for_travel(const ControlInput& in, const CascadeConstants& c) const;
  Quantity follow_pitch_setpoint(const ControlInput& in, const CascadeConstants& c,
                                 bool axes_changed);

  State state_;
  CascadeConstants constants_[kBanks];
};

}  // namespace heli::control
