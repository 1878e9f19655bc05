// The supervisor's commands, streams and checks; see supervisor.hpp. All of it runs in the tick.
// A function that returns a Reply answers a command: result, detail byte, value.
#include "flight/supervisor.hpp"

#include <initializer_list>

#include "control/math.hpp"

namespace heli::flight {

using control::kDegPerRad;
using control::kRadPerDeg;
using control::magnitude;
using link::Event;
using link::Fault;
using link::MessageId;
using link::Reply;
using link::Result;

namespace {

constexpr std::uint8_t kAllAxes = link::axes::elevation | link::axes::pitch | link::axes::travel;

// Landing: the setpoint goes this far below rest, so that the collective voltage falls to zero.
constexpr Quantity kBelowRest_rad = Quantity::of(5.0F * kRadPerDeg);
// The arm has landed when it stays this near to its rest, this slow, for 0.3 s.
constexpr Quantity kTouchdown_rad = Quantity::of(1.5F * kRadPerDeg);
constexpr Quantity kTouchdown_rad_s = Quantity::of(5.0F * kRadPerDeg);
constexpr std::uint32_t kTouchdown_ticks = 300;
// It rests elsewhere when it stays this slow for 1 s without lift. Faster, an arm that sinks slowly
// would seem to rest.
constexpr Quantity kHang_rad_s = Quantity::of(1.0F * kRadPerDeg);
constexpr std::uint32_t kHang_ticks = 1000;
// While the arm tilts by more than this, it brakes its turn and waits with its descent: the voltage
// that holds the tilt would let it sink so slowly that it floats above the table.
constexpr Quantity kBraking_rad = Quantity::of(10.0F * kRadPerDeg);

// Encoders may change their lines while their supply rises: 0.1 s after the start. The host zeroes
// the axes, or the arm is at rest then.
constexpr std::uint32_t kPowerUp_ticks = 100;

// A host that streams invalid values gets at most one event in this time.
constexpr std::uint32_t kRejectEvery_ticks = 500;

constexpr float kNyquist_Hz = 0.5F * control::kTickRate_Hz;

bool in_range(float value, float least, float most) { return value >= least && value <= most; }

// True from the deadline on, for 2^31 ticks (24 days); ticks wrap.
bool passed(std::uint32_t tick, std::uint32_t deadline_tick) {
  return static_cast<std::int32_t>(tick - deadline_tick) >= 0;
}

template <class Enum>
std::uint8_t as_byte(Enum value) {
  return static_cast<std::uint8_t>(value);
}

// Positions of the fields in the declaration; on the wire, `request` precedes the first one.
namespace control_field {
enum : std::uint8_t { axes, front_V, back_V };
}  // namespace control_field
namespace excite_field {
enum : std::uint8_t { kind, front_V, back_V, start_Hz, stop_Hz, duration_s, seed };
}  // namespace excite_field

Reply bad_value(std::uint8_t field, float value = 0.0F) {
  return {Result::bad_value, static_cast<std::uint8_t>(field + 1U), value};
}

}  // namespace

void Supervisor::observe(const Observation& observation, const Limits& limits,
                         const SetpointLimits& bounds, const TrackingLimits& tracking) {
  observation_ = &observation;
  limits_ = &limits;
  setpoint_limits_ = &bounds;
  tracking_limits_ = &tracking;
}

std::uint8_t Supervisor::axes() const {
  switch (state_) {
    case State::closed_loop:
      return axes_;
    case State::hold:
    case State::landing:
      return kAllAxes;
    case State::emergency_landing:
      return blind_descent_idles_
                 ? std::uint8_t{0}
                 : static_cast<std::uint8_t>(trusted_axes_ &
                                             (link::axes::elevation | link::axes::pitch));
    default:
      return 0;
  }
}

// Accepted stream values in the last second: the four complete buckets, without the running one.
std::uint16_t Supervisor::setpoint_rate_Hz() const {
  std::uint16_t sum = 0;
  for (const std::uint16_t count : accepted_values_) {
    sum = static_cast<std::uint16_t>(sum + count);
  }
  return static_cast<std::uint16_t>(sum - accepted_values_[bucket_]);
}

void Supervisor::push_event(Event kind, std::uint8_t detail, std::uint8_t cause, float value) {
  link_.push_event({observation_->tick, as_byte(kind), detail, cause, value});
}

// Applies the state table. False if the present state refuses the trigger; then nothing changes.
bool Supervisor::trigger(Trigger cause) {
  const std::uint8_t next = next_state(state_, cause);
  if (next == kRefused) {
    return false;
  }
  enter(static_cast<State>(next), cause);
  return true;
}

// Changes the state, prepares the setpoints of the new state, and reports the change.
void Supervisor::enter(State next, Trigger cause) {
  if (next == State::hold || descends(next) || !flight::motors_enabled(next)) {
    end_excitation();
  }
  // Hold: the arm stops where it is, level, but not above the highest setpoint.
  if (next == State::hold) {
    const Quantity elevation_rad = observation_->angle_rad[kElevation];
    setpoints_.hold_at(kElevation, elevation_rad < setpoint_limits_->max_rad[kElevation]
                                       ? elevation_rad
                                       : setpoint_limits_->max_rad[kElevation]);
    setpoints_.hold_at(kTravel, observation_->angle_rad[kTravel]);
    setpoints_.hold_at(kPitch, Quantity{});
  }
  // A landing begins at the setpoints of the closed axes, and where the other axes are.
  if (descends(next) && state_ != next) {
    for (const std::size_t axis : {kElevation, kTravel}) {
      const bool closed = (axes() & (1U << axis)) != 0U;
      setpoints_.hold_at(axis,
                         closed ? setpoints_.of(axis).angle_rad : observation_->angle_rad[axis]);
    }
    setpoints_.hold_at(kPitch, Quantity{});
    landing_holds_pitch_level_ = tracking_.is_probing();
    rest_ticks_ = 0;
    hang_ticks_ = 0;
    blind_descent_idles_ = false;
  }
  // Only a fault and an emergency landing keep the fault's number.
  if (next == State::fault) {
    open_voltages_ = {};
  } else if (next != State::emergency_landing) {
    fault_ = Fault::none;
  }
  if (next != state_) {
    state_entered_tick_ = observation_->tick;
    if (cause != Trigger::touchdown) {
      cause_ = cause;
    }
    push_event(Event::state, as_byte(next), as_byte(cause), 0.0F);
  }
  state_ = next;
}

void Supervisor::end_excitation() {
  if (exciter_.running()) {
    push_event(Event::excitation_end, as_byte(exciter_.kind()), 0, 0.0F);
    exciter_.stop();
  }
}

// A fault ends the flight: by a landing without the axis whose reading it has shown to be wrong, or
// by cutting the motors. On the table and on a bench, nothing can fall.
void Supervisor::trip(Fault fault, float value) {
  const std::uint8_t lost_axis = axis_lost_by(fault);
  // An arm that has not counted may have lifted off all the same.
  const bool flies = at_arming_.lifted_off || fault == Fault::elevation_motionless;
  const bool can_land =
      lost_axis != 0U && flies && next_state(state_, Trigger::axis_lost) != kRefused;
  const Trigger cause = can_land ? Trigger::axis_lost : Trigger::trip;
  const bool is_first = state_ != State::emergency_landing;
  if (can_land) {
    trusted_axes_ = static_cast<std::uint8_t>(trusted_axes_ & ~lost_axis);
  }
  trigger(cause);
  if (can_land) {
    const std::uint32_t landing_ticks = observation_->tick - state_entered_tick_;
    blind_descent_ = tracking_.blind_descent(
        at_arming_.lifted_off, limits_->blind_landing_ticks - landing_ticks, *tracking_limits_);
  }
  // The first fault is the reason of the landing.
  if (is_first || !can_land) {
    fault_ = fault;
  }
  push_event(Event::fault, as_byte(fault), as_byte(cause), value);
}

Reply Supervisor::bad_state() const { return {Result::bad_state, as_byte(state_), 0.0F}; }

Reply Supervisor::reply_to_trigger(Trigger cause) {
  return trigger(cause) ? Reply{Result::ok, as_byte(state_), 0.0F} : bad_state();
}

Reply Supervisor::execute(const link::Request& request) {
  switch (request.id) {
    case MessageId::arm:
      return arm();
    case MessageId::stop:
      return reply_to_trigger(Trigger::stop);
    case MessageId::control:
      return control(request.as<link::ControlMessage>());
    case MessageId::stream: {
      const Reply reply = reply_to_trigger(Trigger::stream);
      if (reply.result == Result::ok) {
        // The last voltages act until the first streamed ones arrive, or until their time ends.
        open_voltages_ = observation_->applied;
        host_setpoints_known_ = false;
        axes_ = kAllAxes;
        last_stream_tick_ = observation_->tick;
        voltage_end_tick_ = observation_->tick + limits_->voltage_valid_max_ticks;
      }
      return reply;
    }
    case MessageId::land:
      return reply_to_trigger(Trigger::land);
    case MessageId::excite:
      return excite(request.as<link::ExciteMessage>());
    case MessageId::excite_stop:
      end_excitation();
      return {Result::ok, 0, 0.0F};
    case MessageId::clear_fault:
      if (observation_->hardware_stop && state_ == State::fault) {
        return {Result::check_failed, as_byte(Fault::hardware_stop), 0.0F};
      }
      return reply_to_trigger(Trigger::clear);
    default:
      return {Result::unknown_command, 0, 0.0F};
  }
}

// Checks everything that must hold before arming, and stores the counters that only errors in this
// flight may raise.
Reply Supervisor::arm() {
  if (next_state(state_, Trigger::arm) == kRefused) {
    return bad_state();
  }
  const Verdict verdict = check_before_arming(*observation_, *limits_, stepped_axes_);
  if (verdict.fault != Fault::none) {
    return {Result::check_failed, as_byte(verdict.fault), verdict.value};
  }
  for (std::size_t axis = 0; axis < kAxisCount; ++axis) {
    at_arming_.illegal[axis] = observation_->illegal[axis];
  }
  at_arming_.overruns = observation_->overruns;
  at_arming_.elevation_rad = observation_->angle_rad[kElevation];
  at_arming_.lifted_off = false;
  trusted_axes_ = kAllAxes;
  open_voltages_ = {};
  axes_ = 0;
  return reply_to_trigger(Trigger::arm);
}

// Closes the loops of the requested axes; no axes means open loop with the message's voltages.
Reply Supervisor::control(const link::ControlMessage& message) {
  const std::uint8_t requested_axes = message.axes;
  const bool travel_alone =
      (requested_axes & link::axes::travel) != 0U && (requested_axes & link::axes::pitch) == 0U;
  if ((requested_axes & ~kAllAxes) != 0U || travel_alone) {
    return bad_value(control_field::axes, static_cast<float>(requested_axes));
  }
  if (!in_range(message.front_V, limits_->motor_min_V, limits_->motor_max_V)) {
    return bad_value(control_field::front_V, message.front_V);
  }
  if (!in_range(message.back_V, limits_->motor_min_V, limits_->motor_max_V)) {
    return bad_value(control_field::back_V, message.back_V);
  }
  const auto newly_closed_axes = static_cast<std::uint8_t>(requested_axes & ~axes());
  if (!trigger(requested_axes != 0U ? Trigger::close_loop : Trigger::open_loop)) {
    return bad_state();
  }
  // An axis that was open before is held where it is.
  for (std::size_t axis = 0; axis < kAxisCount; ++axis) {
    if ((newly_closed_axes & (1U << axis)) != 0U) {
      setpoints_.hold_at(axis, observation_->angle_rad[axis]);
    }
  }
  axes_ = requested_axes;
  open_voltages_ = {control::quantity_of(message.front_V), control::quantity_of(message.back_V)};
  last_stream_tick_ = observation_->tick;
  return {Result::ok, as_byte(state_), 0.0F};
}

// Checks an excitation, field by field, and starts it. The number in bad_value() is the field.
Reply Supervisor::excite(const link::ExciteMessage& message) {
  if (state_ != State::closed_loop && state_ != State::open_loop && state_ != State::streamed) {
    return bad_state();
  }
  const auto kind = static_cast<link::Excitation>(message.kind);
  if (message.kind == 0U || message.kind >= link::kExcitationCount) {
    return bad_value(excite_field::kind, static_cast<float>(message.kind));
  }
  if (magnitude(message.front_V) > limits_->excitation_max_V) {
    return bad_value(excite_field::front_V, message.front_V);
  }
  if (magnitude(message.back_V) > limits_->excitation_max_V) {
    return bad_value(excite_field::back_V, message.back_V);
  }
  const bool has_frequency_band =
      kind == link::Excitation::chirp || kind == link::Excitation::multisine;
  if (has_frequency_band && !in_range(message.start_Hz, 0.0F, kNyquist_Hz)) {
    return bad_value(excite_field::start_Hz, message.start_Hz);
  }
  if ((has_frequency_band && !in_range(message.stop_Hz, message.start_Hz, kNyquist_Hz)) ||
      (kind == link::Excitation::prbs && !in_range(message.stop_Hz, 0.01F, kNyquist_Hz))) {
    return bad_value(excite_field::stop_Hz, message.stop_Hz);
  }
  if (!in_range(message.duration_s, control::kTick_s, limits_->excitation_max_s)) {
    return bad_value(excite_field::duration_s, message.duration_s);
  }
  if (kind == link::Excitation::prbs && message.seed == 0U) {
    return bad_value(excite_field::seed);
  }
  end_excitation();
  exciter_.start(message);
  return {Result::ok, message.kind, 0.0F};
}

// Streams get no answer: an invalid value is counted and reported as an event.
void Supervisor::take_stream(const link::StreamValue& value) {
  if (value.id == MessageId::setpoint) {
    take_setpoint(value.setpoint);
  } else if (value.id == MessageId::voltages) {
    take_voltages(value.voltages);
  } else if (state_ == State::streamed) {
    host_setpoint_rad_[kElevation] = control::quantity_of(value.following.elevation_rad);
    host_setpoint_rad_[kPitch] = control::quantity_of(value.following.pitch_rad);
    host_setpoint_rad_[kTravel] = control::quantity_of(value.following.travel_rad);
    host_setpoints_known_ = true;
  }
}

void Supervisor::take_setpoint(const link::SetpointMessage& message) {
  if (state_ != State::closed_loop && state_ != State::hold) {
    reject_stream(Result::bad_state);
    return;
  }
  const Quantity target_rad[kAxisCount] = {control::quantity_of(message.elevation_rad),
                                           control::quantity_of(message.pitch_rad),
                                           control::quantity_of(message.travel_rad)};
  if (!setpoints_.aim(target_rad, message.apply_tick, observation_->tick, *setpoint_limits_)) {
    reject_stream(Result::bad_value);
    return;
  }
  count_accepted();
  if (trigger(Trigger::setpoint_fresh)) {
    push_event(Event::setpoint_fresh, 0, 0, 0.0F);
  }
}

void Supervisor::take_voltages(const link::VoltagesMessage& message) {
  if (state_ != State::streamed) {
    reject_stream(Result::bad_state);
    return;
  }
  if (!in_range(message.front_V, limits_->motor_min_V, limits_->motor_max_V) ||
      !in_range(message.back_V, limits_->motor_min_V, limits_->motor_max_V)) {
    reject_stream(Result::bad_value);
    return;
  }
  open_voltages_ = {control::quantity_of(message.front_V), control::quantity_of(message.back_V)};
  const std::uint32_t valid_ticks = message.valid_ms < limits_->voltage_valid_max_ticks
                                        ? message.valid_ms
                                        : limits_->voltage_valid_max_ticks;
  voltage_end_tick_ = observation_->tick + valid_ticks;
  count_accepted();
}

void Supervisor::count_accepted() {
  ++accepted_values_[bucket_];
  last_stream_tick_ = observation_->tick;
  last_stream_rate_Hz_ = setpoint_rate_Hz();
}

void Supervisor::reject_stream(Result why) {
  ++refused_streams_;
  // Streaming during a landing is no error: the host may not know of the landing yet.
  if (descends(state_) || !passed(observation_->tick, next_reject_event_tick_)) {
    return;
  }
  next_reject_event_tick_ = observation_->tick + kRejectEvery_ticks;
  push_event(Event::setpoint_rejected, as_byte(why), 0, 0.0F);
}

void Supervisor::check_limits() {
  if (!at_arming_.lifted_off) {
    update_floor(at_arming_, *observation_, *limits_);
    sinks_at_take_off_ = flies() && observation_->angle_rad[kElevation] < at_arming_.elevation_rad;
  }
  const Verdict verdict = check_flight(*observation_, at_arming_, *limits_, trusted_axes_);
  if (verdict.fault != Fault::none) {
    trip(verdict.fault, verdict.value);
  } else if (observation_->angle_rad[kElevation] < at_arming_.floor_rad && flies() &&
             (trusted_axes_ & link::axes::elevation) != 0U) {
    trip(at_arming_.lifted_off ? Fault::elevation_below_table : Fault::elevation_sign,
         observation_->angle_rad[kElevation].to_float() * kDegPerRad);
  }
}

// Not in open loop: on a bench, people may hold the arm or clamp an axis on purpose.
void Supervisor::check_tracking() {
  if (!motors_enabled() || state_ == State::armed || state_ == State::open_loop) {
    tracking_.restart();
    return;
  }
  const std::uint8_t closed = axes();
  TrackingInput input{*observation_, {},   closed, state_ == State::streamed ? kAllAxes : closed,
                      false,         false};
  input.setpoint_rad[kElevation] = setpoints_.angle_rad(kElevation);
  input.setpoint_rad[kPitch] = observation_->pitch_setpoint_rad;
  input.setpoint_rad[kTravel] = setpoints_.angle_rad(kTravel);
  input.descends = descends(state_);
  if (input.descends) {
    // Landing aims below the table and has a time limit of its own.
    input.closed = static_cast<std::uint8_t>(closed & ~link::axes::elevation);
  }
  // An uploaded law decides on its voltages itself.
  input.may_probe =
      (closed & link::axes::travel) != 0U && !input.descends && !observation_->law_busy;
  Verdict verdict{Fault::none, 0.0F};
  if (Tracking::is_turn_to_probe(observation_->tick)) {
    verdict = tracking_.probe_travel(input, *tracking_limits_);
    if (tracking_.probe_event() != link::Probe::none) {
      push_event(Event::travel_probe, as_byte(tracking_.probe_event()), 0,
                 tracking_.probe().tilt_rad().to_float() * kDegPerRad);
    }
  } else {
    verdict = tracking_.check(input, *tracking_limits_);
  }
  if (verdict.fault != Fault::none) {
    trip(verdict.fault, verdict.value);
  }
}

// Ends or changes the flight when the host has been silent for too long. The bench states (armed,
// open loop) need any valid frame, the flying ones a fresh stream value.
void Supervisor::check_ages() {
  const std::uint32_t stream_age_ticks = observation_->tick - last_stream_tick_;
  switch (state_) {
    case State::armed:
      if (observation_->link_age_ticks > limits_->land_ticks) {
        trigger(Trigger::stale_land);
      }
      break;
    case State::open_loop:
      if (observation_->link_age_ticks > limits_->hold_ticks) {
        trigger(Trigger::stale_hold);
      }
      break;
    case State::closed_loop:
      if (stream_age_ticks > limits_->hold_ticks) {
        trigger(Trigger::stale_hold);
        push_event(Event::setpoint_stale, 0, 0, static_cast<float>(last_stream_rate_Hz_));
      }
      break;
    case State::streamed:
      if (passed(observation_->tick, voltage_end_tick_)) {
        trigger(Trigger::stale_hold);
        push_event(Event::setpoint_stale, 0, 0, static_cast<float>(last_stream_rate_Hz_));
      }
      break;
    case State::hold:
      if (stream_age_ticks > limits_->land_ticks) {
        trigger(Trigger::stale_land);
      }
      break;
    default:
      break;
  }
}

// One tick of a landing: the setpoint of elevation sinks until the arm rests. Without the elevation
// encoder, the lift decreases until the time of such a landing has passed.
void Supervisor::descend() {
  const std::uint32_t landing_ticks = observation_->tick - state_entered_tick_;
  const std::uint32_t remaining_ticks = limits_->blind_landing_ticks > landing_ticks
                                            ? limits_->blind_landing_ticks - landing_ticks
                                            : 0U;
  if (state_ == State::emergency_landing) {
    open_voltages_ = blind_descent_.voltages(remaining_ticks, tracking_limits_->dead_zone);
    if ((trusted_axes_ & link::axes::elevation) == 0U) {
      blind_descent_idles_ = blind_descent_.idles(remaining_ticks);
      if (remaining_ticks == 0U) {
        trigger(Trigger::touchdown);
      }
      return;
    }
  }
  const Quantity above_rest_rad = observation_->angle_rad[kElevation] - limits_->rest_rad;
  const Quantity speed_rad_s = magnitude(observation_->rate_rad_s[kElevation]);
  holds_pitch_level_ =
      landing_holds_pitch_level_ || landing_ticks > limits_->landing_timeout_ticks / 2U;
  const bool brakes = state_ == State::landing && !holds_pitch_level_ &&
                      magnitude(observation_->angle_rad[kPitch]) > kBraking_rad;
  if (brakes) {
    // The arm is only braked: returning to where the landing began would take longer.
    setpoints_.hold_at(kTravel, observation_->angle_rad[kTravel]);
  } else {
    setpoints_.descend(*setpoint_limits_, limits_->rest_rad - kBelowRest_rad);
  }

  const bool on_table = magnitude(above_rest_rad) < kTouchdown_rad;
  rest_ticks_ = on_table && speed_rad_s < kTouchdown_rad_s ? rest_ticks_ + 1U : 0U;
  const bool hangs =
      !on_table && speed_rad_s < kHang_rad_s && !Tracking::lifts(*observation_, *tracking_limits_);
  hang_ticks_ = hangs ? hang_ticks_ + 1U : 0U;
  if (rest_ticks_ >= kTouchdown_ticks) {
    trigger(Trigger::touchdown);
  } else if (hang_ticks_ >= kHang_ticks) {
    trip(Fault::elevation_rest, observation_->angle_rad[kElevation].to_float() * kDegPerRad);
  } else if (landing_ticks > limits_->landing_timeout_ticks) {
    trip(Fault::landing_timeout, static_cast<float>(landing_ticks) * control::kTick_s);
  }
}

void Supervisor::advance() {
  // The oldest bucket of accepted stream values is emptied and becomes the running one.
  if (passed(observation_->tick, bucket_end_tick_)) {
    bucket_end_tick_ = observation_->tick + kBucket_ticks;
    bucket_ = bucket_ + 1U < kRateBuckets ? bucket_ + 1U : 0U;
    accepted_values_[bucket_] = 0;
  }
  // Until they are zeroed, readings that have stepped forbid to arm.
  if (observation_->tick > kPowerUp_ticks) {
    stepped_axes_ = static_cast<std::uint8_t>(stepped_axes_ | observation_->steps);
  }
  if (motors_enabled()) {
    check_limits();
  }
  check_tracking();
  check_ages();

  // What the state does with the setpoints. Without a loop, they follow the measured angles.
  holds_pitch_level_ = false;
  switch (state_) {
    case State::closed_loop:
    case State::hold:
      setpoints_.advance(*setpoint_limits_);
      break;
    case State::landing:
    case State::emergency_landing:
      descend();
      break;
    default:
      setpoints_.start_at(observation_->angle_rad);
      break;
  }
}

}  // namespace heli::flight
