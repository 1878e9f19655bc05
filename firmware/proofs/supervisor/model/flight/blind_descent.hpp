// What the proofs of the supervisor put in place of the blind descent: any voltages.
#pragma once

#include <cstdint>

#include "any.hpp"
#include "control/mixer.hpp"
#include "flight/observation.hpp"

namespace heli::flight {

class BlindDescent {
 public:
  bool idles(std::uint32_t) const { return proofs::any<bool>(); }
  OpenVoltages voltages(std::uint32_t, const control::DeadZone&) const {
    return {proofs::any<Quantity>(), proofs::any<Quantity>()};
  }
};

}  // namespace heli::flight
