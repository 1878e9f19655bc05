// What the proofs of the mixer assume before a call and prove after it.
#pragma once

#include "control/mixer.hpp"

namespace heli::proofs {

// Sums of four voltages within 32 V do not leave the range of quantities.
inline constexpr std::int32_t kVoltageRoom = std::int32_t{1} << 29;

// A motor's limits are in order and within 32 V; no differential asks for more than they leave.
inline bool holds(const control::MixerLimits& limits) {
  const std::int32_t low = limits.collective_min_V.raw();
  const std::int32_t high = limits.collective_max_V.raw();
  const std::int32_t most = limits.differential_max_V.raw();
  return -2 * kVoltageRoom <= low && low <= 0 && 0 <= high && high < 2 * kVoltageRoom &&
         0 <= most && most <= (high - static_cast<std::int64_t>(low)) / 2;
}

}  // namespace heli::proofs
