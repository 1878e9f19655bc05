// Does an axis turn in the direction of its drive? A wrong sign of an encoder or of a motor makes
// the loop drive the axis away from its setpoint, faster and faster.
//
// The first strong drive of a flight decides, because a sign does not change in the air.
#pragma once

#include <cstdint>

#include "control/fixed.hpp"
#include "flight/balance.hpp"

namespace heli::flight {

// A drive is in volts for pitch and in rad of pitch for travel, as in BalanceLimits.
struct SignLimits {
  Quantity drive_min;       // a weaker drive may lose against a torque on the axis
  Quantity impulse_min;     // drive times T that shows clearly in the rate
  Quantity error_max_rad;   // farther from its setpoint no torque turns a healthy axis
  Quantity turned_min_rad;  // an axis that is held, or whose encoder is dead, turns by less
  std::uint32_t settle_updates = 0;  // until the filtered rate shows what the axis does
};

struct SignInput {
  Quantity drive;
  Quantity rate_rad_s;
  Gain speed_per_rad_s;  // converts the rate to a drive times T
  Quantity angle_rad;
  Quantity error_rad;  // setpoint minus angle
};

class SignCheck {
 public:
  // The sign is right.
  bool is_confirmed() const { return confirmed_; }
  // Once per update of the axis until then. True if the sign is wrong.
  bool is_wrong(const SignInput& axis, const SignLimits& limits) {
    const bool drives_up = axis.drive > Quantity{};
    if (control::magnitude(axis.drive) < limits.drive_min || drives_up != drives_up_) {
      drives_up_ = drives_up;
      driven_updates_ = 0;
      return false;
    }
    const Quantity speed = axis.speed_per_rad_s * axis.rate_rad_s;
    if (++driven_updates_ <= limits.settle_updates) {
      first_speed_ = speed;
      first_angle_rad_ = axis.angle_rad;
      impulse_ = {};
      return false;
    }
    impulse_ += control::magnitude(axis.drive).shifted(Balance::kShift);
    if (impulse_ < limits.impulse_min) {
      return false;
    }
    driven_updates_ = 0;
    const Quantity gained = drives_up ? speed - first_speed_ : first_speed_ - speed;
    const Quantity turned_rad =
        drives_up ? axis.angle_rad - first_angle_rad_ : first_angle_rad_ - axis.angle_rad;
    // Half of what the drive gives: a torque on the axis may take or give the other half.
    confirmed_ = gained > impulse_.half();
    if (turned_rad > -limits.turned_min_rad) {
      return false;
    }
    // A motor that pushes down turns the axis slowly, as the lift increases.
    const bool is_far = control::magnitude(axis.error_rad) > limits.error_max_rad;
    return gained < -impulse_.half() || (is_far && gained < impulse_.half().half());
  }

 private:
  bool confirmed_ = false;
  bool drives_up_ = false;
  std::uint32_t driven_updates_ = 0;  // in one direction
  Quantity first_speed_;
  Quantity first_angle_rad_;
  Quantity impulse_;
};

}  // namespace heli::flight
