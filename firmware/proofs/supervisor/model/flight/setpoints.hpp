// What the proofs of the supervisor put in place of the setpoints: they answer anything.
#pragma once

#include "any.hpp"
#include "board.hpp"
#include "control/fixed.hpp"

namespace heli::flight {

using control::Quantity;

struct Setpoint {
  Quantity angle_rad;
  Quantity rate_rad_s;
  Quantity acceleration_rad_s2;
};

struct SetpointLimits {
  Quantity max_rad[kAxisCount];
};

class Setpoints {
 public:
  void start_at(const Quantity (&)[kAxisCount]) {}
  void hold_at(std::size_t axis, Quantity) { CLAIM(axis < kAxisCount, "the axis exists"); }
  void continue_from(std::size_t, Quantity) {}
  bool aim(const Quantity (&)[kAxisCount], std::uint32_t, std::uint32_t, const SetpointLimits&) {
    return proofs::any<bool>();
  }
  void advance(const SetpointLimits&) {}
  void descend(const SetpointLimits&, Quantity) {}
  Setpoint of(std::size_t) const { return {}; }
  Quantity angle_rad(std::size_t) const { return {}; }
};

}  // namespace heli::flight
