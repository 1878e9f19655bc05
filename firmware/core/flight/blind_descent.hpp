// A descent without the encoder of elevation or pitch: the voltages that held the last hover
// decrease to those of no lift.
//
// Without a reading, no loop can be closed. An arm whose weight grows with its elevation sinks with
// its lift; another falls, but slower than without voltage. The arm may swing when its encoder
// fails. It then touches the table while the rotors idle, which ends the swing.
#pragma once

#include <cstdint>

#include "control/fixed.hpp"
#include "control/math.hpp"
#include "control/mixer.hpp"
#include "flight/observation.hpp"

namespace heli::flight {

class BlindDescent {
 public:
  BlindDescent() = default;
  // `lift_V`: sum of both lifts, and `difference_V`: front minus back, that held the last hover.
  BlindDescent(Quantity lift_V, Quantity difference_V, std::uint32_t duration_ticks)
      : lift_V_(lift_V),
        difference_V_(difference_V),
        share_per_tick_(
            control::Share::of(control::reciprocal(static_cast<float>(duration_ticks)))),
        duration_ticks_(duration_ticks) {}

  // Whether the arm has sunk, and the rotors only turn until it has come to rest. Pitch is then
  // open, too: its loop lifts the arm by the noise of the encoder.
  bool idles(std::uint32_t remaining_ticks) const {
    return time_share(remaining_ticks) <= kIdleTime;
  }

  // The motor voltages when `remaining_ticks` of the duration remain; none at its end.
  OpenVoltages voltages(std::uint32_t remaining_ticks, const control::DeadZone& dead_zone) const {
    if (remaining_ticks == 0U) {
      return {};
    }
    if (idles(remaining_ticks)) {
      const Quantity idle_V = dead_zone.zone_V - dead_zone.zone_V.shifted(3);
      return {idle_V, idle_V};
    }
    const Quantity share = kSlope * (time_share(remaining_ticks) - kIdleTime);
    const Quantity lift_V = share * lift_V_;
    const Quantity difference_V = share * difference_V_;
    return {(lift_V + difference_V).half() + dead_zone.zone_V,
            (lift_V - difference_V).half() + dead_zone.zone_V};
  }

 private:
  // In the last share of the time, 10 of 18 s, the rotors turn without lift. The table takes the
  // speed of an arm that swings down, which the paper's rig does every 5 s; an arm that floats
  // comes to rest. With 5 s, it swung by up to 10 degrees when the motors ended. A faster descent
  // before leaves more swing.
  static constexpr float kIdlePart = 10.0F / 18.0F;
  static constexpr Quantity kIdleTime = Quantity::of(kIdlePart);
  static constexpr Quantity kSlope = Quantity::of(1.0F / (1.0F - kIdlePart));

  // 1 at the beginning, 0 at the end.
  Quantity time_share(std::uint32_t remaining_ticks) const {
    const std::uint32_t ticks =
        remaining_ticks < duration_ticks_ ? remaining_ticks : duration_ticks_;
    return control::product<24>(control::Whole::from_raw(static_cast<std::int32_t>(ticks)),
                                share_per_tick_);
  }

  Quantity lift_V_;
  Quantity difference_V_;
  control::Share share_per_tick_;
  std::uint32_t duration_ticks_ = 0;
};

}  // namespace heli::flight
