// A sample of your own compiled controller: linear-quadratic state feedback, without integrators.
#pragma once

#include "control/controller.hpp"
#include "control/loop.hpp"
#include "control/mixer.hpp"

namespace heli::control {

class Lqr final : public Controller {
 public:
  void derive(IdleLoop, const params::Params& params, Bank bank) override;
  void init() override;
  ControlOutput update(const ControlInput& in, Bank bank) override;
  void shadow(const ControlInput& in, Bank bank, const ControlOutput& acting) override;
  void take_over() override;

 private:
  struct Constants {
    Quantity hover_V;  // lift of both motors together that holds the arm level
    Gain hover_V_per_rad;
    Gain pitch_hold_V_per_rad;
    DeadZone dead_zone;
    MixerLimits mixer;
    Quantity motor_min_V;
    Quantity motor_max_V;
    Share bumpless_keep;
  };

  Constants constants_[kBanks];
  BumplessTransfer front_;
  BumplessTransfer back_;
  Quantity front_V_;  // of the previous tick, without excitation
  Quantity back_V_;
  std::uint8_t axes_ = 0;
  bool travel_waits_ = false;
  bool begins_ = true;  // the next output begins at the voltages of the previous tick
};

}  // namespace heli::control
