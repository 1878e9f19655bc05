// What the proofs of the supervisor put in place of the tracking: it finds anything.
#pragma once

#include "any.hpp"
#include "flight/limits.hpp"
#include "flight/observation.hpp"

namespace heli::flight {

struct TrackingLimits {};

struct Tracked {
  const Observation& seen;
  Quantity setpoint_rad[kAxisCount];
  std::uint8_t closed = 0;
  std::uint8_t driven = 0;
  bool may_ask = false;
  bool descends = false;
};

struct Probe {
  Quantity pitch_rad() const { return {}; }
  Quantity tilt_rad() const { return {}; }
};

class Tracking {
 public:
  void restart() {}
  Verdict check(const Tracked&, const TrackingLimits&) { return finding(); }
  static bool is_turn_to_ask(std::uint32_t) { return proofs::any<bool>(); }
  Verdict ask(const Tracked&, const TrackingLimits&) { return finding(); }
  link::Probe news() const { return proofs::any<link::Probe>(); }
  Probe probe() const { return {}; }
  bool asks() const { return proofs::any<bool>(); }

 private:
  static Verdict finding() { return {proofs::any<link::Fault>(), 0.0F}; }
};

}  // namespace heli::flight
