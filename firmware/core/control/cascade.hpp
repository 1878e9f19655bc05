// The paper's control law: travel -> pitch setpoint -> differential voltage; elevation ->
// collective voltage (eqs. 32-34), with limits, anti-windup and smooth changes.
#pragma once

#include "control/bumpless_transfer.hpp"
#include "control/cascade_constants.hpp"
#include "control/controller.hpp"
#include "control/pid.hpp"

namespace heli::control {

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
