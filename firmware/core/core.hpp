// The flight code: one tick a millisecond, and what the idle loop does between ticks.
#pragma once

#include <atomic>
#include <cstdint>

#include "board.hpp"
#include "control/controller.hpp"
#include "control/loop.hpp"
#include "conversion.hpp"
#include "flight/limits.hpp"
#include "flight/observation.hpp"
#include "flight/setpoints.hpp"
#include "flight/supervisor.hpp"
#include "flight/tracking.hpp"
#include "law/simplex.hpp"
#include "law/uploaded_law.hpp"
#include "link/link.hpp"
#include "link/telemetry.hpp"
#include "params/params.hpp"
#include "params/store.hpp"

namespace heli {

// Duration of the previous tick, as measured by the board.
struct TickTiming {
  std::uint16_t last_us = 0;
  bool late = false;
};

class Core {
 public:
  // `uploaded` is a law received over the link, if any; `laws` runs it or a compiled controller.
  Core(Board& board, law::Simplex& laws, law::UploadedLaw& uploaded);

  // Once, before the first tick: loads the parameters, announces the boot.
  void start();

  // Once a millisecond, from the timer's interrupt. Encoders in, motors out, one sample logged.
  void tick(TickTiming timing = {});

  // Called repeatedly by the idle loop: serves the link, and derives constants after a parameter
  // change.
  void poll();

  link::State state() const { return supervisor_.state(); }

 private:
  // Everything that the tick needs from the parameters, except the law's constants.
  struct Derived {
    Conversion conversion;
    flight::Limits limits;
    flight::SetpointLimits setpoint_limits;
    flight::TrackingLimits tracking;
  };

  void refresh_derived();  // idle loop
  // All that follows runs in the tick.
  void measure(const EncoderReading& reading, const Conversion& c,
               const std::uint32_t (&step_max_counts)[kAxisCount]);
  void zero(const EncoderReading& reading, std::uint8_t axes);
  link::Reply execute(const link::Request& request, const EncoderReading& reading);
  link::Reply set_parameter(const link::ParamSetMessage& message, bool idle);
  link::Reply fly_law(bool on);
  // Called by tick(), in this order after the supervisor has advanced.
  control::ControlOutput compute_output(control::Bank bank);
  void write_motors(const control::ControlOutput& out, const Conversion& c);
  void log_law(link::Sample& sample);
  void log_tick(const control::ControlOutput& out, TickTiming timing);

  Board& board_;
  law::Simplex& laws_;
  law::UploadedLaw& uploaded_;
  params::Params params_;
  params::Store store_;
  link::Link link_;
  flight::Supervisor supervisor_;
  control::RateFilter filters_[kAxisCount];

  // The idle loop fills the bank that is not active, the law's too, then switches; a tick never
  // runs half-way through a switch, because it is one byte.
  Derived derived_[control::kBanks]{};
  std::atomic<control::Bank> active_{0};
  std::uint32_t derived_revision_ = 0;

  bool zeroed_ = false;                       // the first tick has set the zero
  std::int32_t zero_count_[kAxisCount] = {};  // board's counts at the zero of each axis
  std::int32_t raw_count_[kAxisCount] = {};   // board's counts when steps were last looked for
  flight::Observation observation_{};
  bool excited_ = false;
  link::TickCounters counters_;
};

}  // namespace heli
