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

// Everything here runs in the tick. Axes are link::axes bits.
class Supervisor {
 public:
  explicit Supervisor(link::Link& link) : link_(link) {}

  // Must precede the other calls of a tick. The supervisor keeps the addresses: the observation
  // must not change before advance() returns, and the limits not before the tick ends.
  void observe(const Observation& observation, const Limits& limits, const SetpointLimits& bounds,
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
  OpenVoltages open_voltages() const { return open_voltages_; }
  Setpoint setpoint(std::size_t axis) const { return setpoints_.of(axis); }
  Quantity setpoint_rad(std::size_t axis) const { return setpoints_.angle_rad(axis); }
  // The setpoint continues to its target from there.
  void continue_from(std::size_t axis, Quantity angle_rad) {
    setpoints_.continue_from(axis, angle_rad);
  }
  // Elevation sinks at take-off, against the rotors' lift: no motor gets more than in a hover.
  bool sinks_at_take_off() const { return sinks_at_take_off_; }
  Quantity hover_motor_V() const { return limits_->hover_motor_V; }
  // Travel's loop waits, and pitch follows waiting_pitch_rad(), in three cases: a probing tilt
  // tests travel's encoder; such a tilt had no result when the landing began; or a landing has used
  // half of its time. The last because holding a tilt takes so much voltage that the arm may not
  // sink.
  bool travel_waits() const { return holds_pitch_level_ || tracking_.is_probing(); }
  Quantity waiting_pitch_rad() const {
    return holds_pitch_level_ ? Quantity{} : tracking_.probe().pitch_rad();
  }
  // These axes have a new zero: what their readings did before no longer matters.
  void forget_steps(std::uint8_t axes) {
    stepped_axes_ = static_cast<std::uint8_t>(stepped_axes_ & ~axes);
  }
  // Forgets the motion of the axes until now.
  void restart_tracking() { tracking_.restart(); }
  // Whether the host streams voltages and has sent the setpoints of its law; those are only logged.
  bool host_setpoints_known() const { return host_setpoints_known_ && state_ == State::streamed; }
  Quantity host_setpoint_rad(std::size_t axis) const { return host_setpoint_rad_[axis]; }
  bool link_alive() const { return observation_->link_age_ticks <= limits_->hold_ticks; }
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
  void trip(link::Fault fault, float value);
  void descend();
  void count_accepted();
  void reject_stream(link::Result why);
  void push_event(link::Event kind, std::uint8_t detail, std::uint8_t cause, float value);
  // Not in open loop: on a bench, people may hold the arm.
  bool flies() const { return state_ != State::open_loop && state_ != State::armed; }
  void check_limits();
  void check_tracking();
  void check_ages();
  link::Reply bad_state() const;

  link::Reply arm();
  link::Reply control(const link::ControlMessage& message);
  link::Reply excite(const link::ExciteMessage& message);
  link::Reply reply_to_trigger(Trigger cause);
  void take_setpoint(const link::SetpointMessage& message);
  void take_voltages(const link::VoltagesMessage& message);

  link::Link& link_;
  const Observation* observation_ = nullptr;
  const Limits* limits_ = nullptr;
  const SetpointLimits* setpoint_limits_ = nullptr;
  const TrackingLimits* tracking_limits_ = nullptr;
  Setpoints setpoints_;
  Tracking tracking_;
  control::Exciter exciter_;

  State state_ = State::idle;
  link::Fault fault_ = link::Fault::none;
  Trigger cause_ = Trigger::start;
  std::uint8_t axes_ = 0;
  std::uint8_t trusted_axes_ = 0;  // whose readings no fault has shown to be wrong since arming
  std::uint8_t stepped_axes_ = 0;  // whose readings have stepped since they were zeroed
  OpenVoltages open_voltages_{};
  bool host_setpoints_known_ = false;
  Quantity host_setpoint_rad_[kAxisCount];
  std::uint32_t state_entered_tick_ = 0;
  std::uint32_t last_stream_tick_ = 0;      // of the last accepted stream value
  std::uint32_t voltage_end_tick_ = 0;      // streamed voltage acts until then
  bool holds_pitch_level_ = false;          // now, in a landing
  bool landing_holds_pitch_level_ = false;  // during the whole landing
  std::uint32_t rest_ticks_ = 0;            // at rest on the table while landing
  std::uint32_t hang_ticks_ = 0;            // at rest elsewhere, without lift
  BlindDescent blind_descent_;              // without the elevation or the pitch encoder
  bool sinks_at_take_off_ = false;          // elevation, against the rotors' lift
  bool blind_descent_idles_ = false;        // its rotors only turn, without lift
  AtArming at_arming_{};
  std::uint32_t refused_streams_ = 0;
  std::uint32_t next_reject_event_tick_ = 0;
  std::uint16_t accepted_values_[kRateBuckets] = {};
  std::uint32_t bucket_end_tick_ = 0;
  std::uint32_t bucket_ = 0;
  std::uint16_t last_stream_rate_Hz_ = 0;
};

}  // namespace heli::flight
