// Whether a law that came over the link may go on: what it asks for, and where the arm is going.
//
// The supervisor stands above every law and switches the motors off at its limits. The guard comes
// before: it has the board's own law take over while that can still save the flight.
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

// From the parameters, in the idle loop.
struct GuardLimits {
  Quantity jump_max_V;
  Quantity angle_max_rad[kAxisCount];
  Quantity rate_max_rad_s[kAxisCount];
  Quantity table_rad;
  Gain braking_s2[kAxisCount];  // angle to brake in, for each (rad/s)^2; 0: not foreseen
  Gain lift_rad_s2_per_V;       // acceleration of elevation by lift beyond hover's
  Quantity hover_V;             // lift that carries the arm at level
  Gain hover_V_per_rad;         // and what it takes more, the higher the arm is
  control::DeadZone dead_zone;
  Quantity following_max_rad[kAxisCount];
  // From here on the supervisor counts as well, and the way back takes part of its time.
  Quantity following_end_rad[kAxisCount];
  std::uint32_t following_ticks = 0;
};

// Lift of two motors beyond what carries the arm there.
Quantity spare_lift_V(Quantity front_V, Quantity back_V, Quantity elevation_rad,
                      const GuardLimits& limits);

GuardLimits guard_limits_of(const params::Params& params);

// What a law asks for in a tick.
struct Wish {
  Quantity front_V;
  Quantity back_V;
  Quantity pitch_setpoint_rad;
};

struct Judgement {
  Takeover reason = Takeover::command;  // this one: the law may go on
  float value = 0.0F;
};

class Guard {
 public:
  void restart() {
    for (std::uint32_t& ticks : astray_ticks_) {
      ticks = 0;
    }
  }
  // `before`: what acted in the tick before.
  Judgement check(const control::ControlInput& in, const Wish& wish, const Wish& before,
                  const GuardLimits& limits);

 private:
  Judgement check_envelope(const control::ControlInput& in, const Wish& before,
                           const GuardLimits& limits) const;
  Judgement check_following(const control::ControlInput& in, const Wish& wish,
                            const GuardLimits& limits);

  std::uint32_t astray_ticks_[kAxisCount] = {};
};

}  // namespace heli::law
