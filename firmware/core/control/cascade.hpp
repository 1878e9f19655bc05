// The paper's control law: travel -> pitch setpoint -> differential voltage; elevation ->
// collective voltage (eqs. 32-34), with what a machine needs beyond the equations.
#pragma once

#include "control/controller.hpp"
#include "control/pid.hpp"

namespace heli::control {

// Takes over a signal without a jump: what the new source differs by at the moment of the change is
// added to it and fades out.
class Fade {
 public:
  float apply(float fresh, float previous, bool changed, float keep) {
    jump_ = changed ? previous - fresh : jump_ * keep;
    return fresh + jump_;
  }

 private:
  float jump_ = 0.0F;
};

class Cascade {
 public:
  // Called before the first update() after the motors were off: forgets everything.
  void reset() { *this = Cascade{}; }

  ControlOutput update(const ControlInput& in, const Constants& c);

 private:
  ControlOutput all_open(const ControlInput& in, const Constants& c, bool changed);
  float lift_for_elevation(const ControlInput& in, const Constants& c, float error_rad) const;
  float pitch_for_travel(const ControlInput& in, const Constants& c) const;
  float follow_pitch_setpoint(const ControlInput& in, const Constants& c, bool changed);

  Pid elevation_;
  Pid pitch_;
  Pid travel_;
  Fade collective_fade_;
  Fade differential_fade_;
  Fade pitch_setpoint_fade_;
  Fade front_fade_;
  Fade back_fade_;
  std::uint8_t axes_ = 0;
  bool started_ = false;
  float front_V_ = 0.0F;  // motor volts of the previous tick, without excitation
  float back_V_ = 0.0F;
  float collective_V_ = 0.0F;  // lift volts achieved in the previous tick, without excitation
  float differential_V_ = 0.0F;
  float pitch_setpoint_rad_ = 0.0F;
  float pitch_setpoint_excess_rad_ = 0.0F;
};

}  // namespace heli::control
