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
  Quantity drive_min;                // a weaker drive may lose against a torque on the axis
  Quantity impulse_min;              // drive times T that shows clearly in the rate
  Quantity angle_max_rad;            // farther against its drive no torque turns a healthy axis
  std::uint32_t settle_updates = 0;  // until the filtered rate shows what the axis does
};

class SignCheck {
 public:
  // Once per update of the axis, with its speed as a drive times T, and its angle from the
  // setpoint. True if the sign is wrong.
  bool is_wrong(Quantity drive, Quantity speed, Quantity angle_rad, const SignLimits& limits) {
    const bool drives_up = drive > Quantity{};
    if (confirmed_ || control::magnitude(drive) < limits.drive_min || drives_up != drives_up_) {
      drives_up_ = drives_up;
      driven_updates_ = 0;
      return false;
    }
    if (++driven_updates_ <= limits.settle_updates) {
      first_speed_ = speed;
      impulse_ = {};
      return false;
    }
    impulse_ += control::magnitude(drive).shifted(Balance::kShift);
    if (impulse_ < limits.impulse_min) {
      return false;
    }
    const Quantity gained = drives_up ? speed - first_speed_ : first_speed_ - speed;
    driven_updates_ = 0;
    // Half of what the drive gives: a torque on the axis may take or give the other half.
    confirmed_ = gained > impulse_.half();
    // A motor that pushes down turns the axis slowly, as the lift increases.
    const bool recedes = drives_up ? angle_rad < -limits.angle_max_rad && speed < Quantity{}
                                   : angle_rad > limits.angle_max_rad && speed > Quantity{};
    return gained < -impulse_.half() || (recedes && gained < impulse_.half().half());
  }

 private:
  bool confirmed_ = false;
  bool drives_up_ = false;
  std::uint32_t driven_updates_ = 0;  // in one direction
  Quantity first_speed_;
  Quantity impulse_;
};

}  // namespace heli::flight
