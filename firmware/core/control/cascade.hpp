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
  Quantity apply(Quantity fresh, Quantity previous, bool changed, Share keep) {
    jump_ = changed ? previous - fresh : shrunk(jump_, keep);
    return fresh + jump_;
  }

 private:
  Quantity jump_;
};

class Cascade {
 public:
  // Called before the first update() after the motors were off: forgets everything.
  void reset() { *this = Cascade{}; }

  // Never inlined: its instructions are counted by its name.
  [[gnu::noinline]] ControlOutput update(const ControlInput& in, const Constants& c);

 private:
  ControlOutput all_open(const ControlInput& in, const Constants& c, bool changed);
  Quantity lift_for_elevation(const ControlInput& in, const Constants& c, Quantity error_rad) const;
  Quantity pitch_for_travel(const ControlInput& in, const Constants& c) const;
  Quantity follow_pitch_setpoint(const ControlInput& in, const Constants& c, bool changed);

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
  Quantity front_V_;  // motor volts of the previous tick, without excitation
  Quantity back_V_;
  Quantity collective_V_;  // lift volts achieved in the previous tick, without excitation
  Quantity differential_V_;
  Quantity pitch_setpoint_rad_;
  Quantity pitch_setpoint_excess_rad_;
};

}  // namespace heli::control
