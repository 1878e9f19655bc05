// What the proofs of the duty assume before a call and prove after it.
#pragma once

#include "conversion.hpp"

namespace heli::proofs {

// The motors' limits as duties are within full duty.
inline bool holds(const MotorConversion& motor, std::int32_t duty_full) {
  return -duty_full <= motor.min_duty && motor.min_duty <= motor.max_duty &&
         motor.max_duty <= duty_full;
}

}  // namespace heli::proofs
