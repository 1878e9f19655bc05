// What the proofs of the supervisor put in place of the tracking: it finds anything.
#pragma once

#include "any.hpp"
#include "control/mixer.hpp"
#include "flight/blind_descent.hpp"
#include "flight/limits.hpp"
#include "flight/observation.hpp"

namespace heli::flight {

struct TrackingLimits {
  control::DeadZone dead_zone;
};

struct TrackingInput {
  const Observation& seen;
  Quantity setpoint_rad[kAxisCount];
  std::uint8_t closed = 0;
  std::uint8_t driven = 0;
  bool may_probe = false;
  bool descends = false;
};

struct Probe {
  Quantity pitch_rad() const { return {}; }
  Quantity tilt_rad() const { return {}; }
};

class Tracking {
 public:
  void restart() {}
  Verdict check(const TrackingInput&, const TrackingLimits&) { return finding(); }
  static bool is_turn_to_probe(std::uint32_t) { return proofs::any<bool>(); }
  Verdict probe_travel(const TrackingInput&, const TrackingLimits&) { return finding(); }
  link::Probe probe_event() const { return proofs::any<link::Probe>(); }
  Probe probe() const { return {}; }
  BlindDescent blind_descent(bool, std::uint32_t, const TrackingLimits&) const { return {}; }
  static bool lifts(const Observation&, const TrackingLimits&) { return proofs::any<bool>(); }
  bool is_probing() const { return proofs::any<bool>(); }

 private:
  static Verdict finding() { return {proofs::any<link::Fault>(), 0.0F}; }
};

}  // namespace heli::flight
