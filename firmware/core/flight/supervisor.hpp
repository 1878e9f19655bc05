// Runs the state table: executes commands, checks limits and ages, decides what drives the motors.
#pragma once

#include <cstdint>

#include "board.hpp"
#include "control/excitation.hpp"
#include "flight/limits.hpp"
#include "flight/observation.hpp"
#include "flight/setpoints.hpp"
#include "flight/state_table.hpp"
#include "flight/tracking.hpp"
#include "link/link.hpp"

namespace heli::flight {

class Supervisor {
 public:
  explicit Supervisor(link::Link& link) : link_(link) {}

  // Once a tick. The caller changes none of it before the supervisor has advanced, and the limits
  // not before the tick ends.
  void observe(const Observation& seen, const Limits& limits, const SetpointLimits& bounds,
               const TrackingLimits& tracking);

  // Commands that concern the flight; parameters and zeroing are the core's.
  link::Reply execute(const link::Request& request);
  void take_stream(const link::StreamValue& value);
  // Limits, ages, landing, setpoints: once a tick after commands and streams.
  void advance();

  State state() const { return state_; }
  link::Fault fault() const { return fault_; }
  // The reason for the state. A touchdown does not replace the reason for the landing.
  Trigger cause() const { return cause_; }
  bool motors_enabled() const { return flight::motors_enabled(state_); }
  // Axes that the control law closes now; none in open loop.
  std::uint8_t axes() const;
  OpenVoltages open_voltages() const { return open_; }
  Setpoint setpoint(std::size_t axis) const { return setpoints_.of(axis); }
  Quantity setpoint_rad(std::size_t axis) const { return setpoints_.angle_rad(axis); }
  // The setpoint continues to its target from there.
  void continue_from(std::size_t axis, Quantity angle_rad) {
    setpoints_.continue_from(axis, angle_rad);
  }
  // Travel's loop waits while a tilt asks whether travel counts, in a landing that such a tilt has
  // not answered, and at the end of a landing that does not come down: to hold a tilt takes so much
  // voltage that the arm may not sink.
  bool travel_waits() const { return levels_ || tracking_.asks(); }
  Quantity waiting_pitch_rad() const {
    return levels_ ? Quantity{} : tracking_.probe().pitch_rad();
  }
  // Forgets the motion of the axes until now.
  void restart_tracking() { tracking_.restart(); }
  // Whether a law on the host flies and has sent setpoints; those are only logged.
  bool follows() const { return follows_ && state_ == State::streamed; }
  Quantity following_rad(std::size_t axis) const { return following_rad_[axis]; }
  bool link_alive() const { return seen_->link_age_ticks <= limits_->hold_ticks; }
  control::Exciter& exciter() { return exciter_; }
  std::uint32_t refused_streams() const { return refused_streams_; }
  std::uint16_t setpoint_rate_Hz() const;

 private:
  // Accepted stream values in quarters of a second: the running one and the last four.
  static constexpr std::uint32_t kRateBuckets = 5;
  static constexpr std::uint32_t kBucket_ticks = 250;

  bool trigger(Trigger cause);
  void enter(State next, Trigger cause);
  void end_excitation();
  void trip(link::Fault fault, float value, Trigger cause = Trigger::trip);
  void count_accepted();
  void reject(link::Result why);
  void event(link::Event kind, std::uint8_t detail, std::uint8_t cause, float value);
  void check_limits();
  void check_tracking();
  void check_ages();
  bool touched_down();
  link::Reply refuse_state() const;

  link::Reply arm();
  link::Reply control(const link::ControlMessage& message);
  link::Reply excite(const link::ExciteMessage& message);
  link::Reply plain(Trigger cause);
  void take_setpoint(const link::SetpointMessage& message);
  void take_voltages(const link::VoltagesMessage& message);

  link::Link& link_;
  const Observation* seen_ = nullptr;
  const Limits* limits_ = nullptr;
  const SetpointLimits* bounds_ = nullptr;
  const TrackingLimits* tracking_limits_ = nullptr;
  Setpoints setpoints_;
  Tracking tracking_;
  control::Exciter exciter_;

  State state_ = State::idle;
  link::Fault fault_ = link::Fault::none;
  Trigger cause_ = Trigger::start;
  std::uint8_t axes_ = 0;
  OpenVoltages open_{};
  bool follows_ = false;
  Quantity following_rad_[kAxisCount];
  std::uint32_t entered_tick_ = 0;
  std::uint32_t fresh_tick_ = 0;        // last accepted stream value
  std::uint32_t voltage_end_tick_ = 0;  // streamed voltage acts until then
  bool levels_ = false;                 // pitch, to land
  bool lands_level_ = false;            // from the beginning
  std::uint32_t quiet_ticks_ = 0;       // at rest on the table while landing
  AtArming at_arming_{};
  std::uint32_t refused_streams_ = 0;
  std::uint32_t next_reject_event_tick_ = 0;
  std::uint16_t accepted_[kRateBuckets] = {};
  std::uint32_t bucket_end_tick_ = 0;
  std::uint32_t bucket_ = 0;
  std::uint16_t rate_when_fresh_Hz_ = 0;
};

}  // namespace heli::flight
