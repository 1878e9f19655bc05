// Decides whether an uploaded law may keep flying, from its outputs and the arm's motion.
//
// The supervisor watches every law and switches the motors off at its limits. The guard acts
// earlier: it lets the board's own law take over while that can still save the flight.
#pragma once

#include <cstdint>

#include "board.hpp"
#include "control/controller.hpp"
#include "control/fixed.hpp"
#include "control/mixer.hpp"
#include "params/params.hpp"

namespace heli::law {

using control::Gain;
using control::Quantity;
using link::Takeover;

// Derived from the parameters in the idle loop.
struct GuardLimits {
  Quantity jump_max_V;  // change of a motor's voltage from one output of the law to the next
  Quantity angle_max_rad[kAxisCount];
  Quantity rate_max_rad_s[kAxisCount];
  Quantity table_rad;           // elevation of the table
  Gain braking_s2[kAxisCount];  // angle to brake in, per (rad/s)^2; 0: not predicted
  Gain lift_rad_s2_per_V;       // acceleration of elevation by lift beyond hover's
  Quantity hover_V;             // lift that carries the arm at level
  Gain hover_V_per_rad;         // additional lift per elevation
  control::DeadZone dead_zone;
  Quantity following_max_rad[kAxisCount];
  // From this error on the supervisor counts the time to its own limit, of which the return takes a
  // part; so the guard allows no time here.
  Quantity following_end_rad[kAxisCount];
  std::uint32_t following_ticks = 0;  // time above following_max_rad that is tolerated
};

// Lift of both motors in excess of what carries the arm at that elevation.
Quantity excess_lift_V(Quantity front_V, Quantity back_V, Quantity elevation_rad,
                       const GuardLimits& limits);

GuardLimits guard_limits_of(const params::Params& params);

// A law's output in one tick.
struct LawOutput {
  Quantity front_V;
  Quantity back_V;
  Quantity pitch_setpoint_rad;
};

struct GuardVerdict {
  Takeover reason = Takeover::command;  // `command`: the law may keep flying
  float value = 0.0F;
};

class Guard {
 public:
  void restart() {
    for (std::uint32_t& ticks : error_ticks_) {
      ticks = 0;
    }
  }
  // Once per tick. `previous`: the output that acted in the previous tick.
  GuardVerdict check(const control::ControlInput& in, const LawOutput& output,
                     const LawOutput& previous, const GuardLimits& limits);

 private:
  GuardVerdict check_envelope(const control::ControlInput& in, const LawOutput& previous,
                              const GuardLimits& limits) const;
  GuardVerdict check_following(const control::ControlInput& in, const LawOutput& output,
                               const GuardLimits& limits);

  std::uint32_t error_ticks_[kAxisCount] = {};
};

}  // namespace heli::law
