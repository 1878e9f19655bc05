#include "flight/supervisor.hpp"

#include <initializer_list>

#include "control/math.hpp"

namespace heli::flight {

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
constexpr Quantity kTouchdown_rad = Quantity::of(1.5F * kRadPerDeg);
constexpr Quantity kTouchdown_rad_s = Quantity::of(5.0F * kRadPerDeg);
constexpr std::uint32_t kTouchdown_ticks = 300;

// A host that streams invalid values gets at most one event in this time.
constexpr std::uint32_t kRejectEvery_ticks = 500;

constexpr float kNyquist_Hz = 0.5F * control::kTickRate_Hz;

bool within(float value, float least, float most) { return value >= least && value <= most; }

bool passed(std::uint32_t tick, std::uint32_t deadline_tick) {
  return static_cast<std::int32_t>(tick - deadline_tick) >= 0;
}

template <class Enum>
std::uint8_t code(Enum value) {
  return static_cast<std::uint8_t>(value);
}

// `field`: position in the declaration; on the wire, `request` precedes the first field.
Reply bad_value(std::uint8_t field, float value = 0.0F) {
  return {Result::bad_value, static_cast<std::uint8_t>(field + 1U), value};
}

}  // namespace

void Supervisor::observe(const Observation& seen, const Limits& limits,
                         const SetpointLimits& bounds, const TrackingLimits& tracking) {
  seen_ = &seen;
  limits_ = &limits;
  bounds_ = &bounds;
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
      return link::axes::elevation | link::axes::pitch;
    default:
      return 0;
  }
}

std::uint16_t Supervisor::setpoint_rate_Hz() const {
  std::uint16_t sum = 0;
  for (const std::uint16_t count : accepted_) {
    sum = static_cast<std::uint16_t>(sum + count);
  }
  return static_cast<std::uint16_t>(sum - accepted_[bucket_]);
}

void Supervisor::event(Event kind, std::uint8_t detail, std::uint8_t cause, float value) {
  link_.push_event({seen_->tick, code(kind), detail, cause, value});
}

bool Supervisor::trigger(Trigger cause) {
  const std::uint8_t next = next_state(state_, cause);
  if (next == kRefused) {
    return false;
  }
  enter(static_cast<State>(next), cause);
  return true;
}

void Supervisor::enter(State next, Trigger cause) {
  if (next == State::hold || descends(next) || !flight::motors_enabled(next)) {
    end_excitation();
  }
  if (next == State::hold) {
    const Quantity elevation_rad = seen_->angle_rad[kElevation];
    setpoints_.hold_at(kElevation, elevation_rad < bounds_->max_rad[kElevation]
                                       ? elevation_rad
                                       : bounds_->max_rad[kElevation]);
    setpoints_.hold_at(kTravel, seen_->angle_rad[kTravel]);
    setpoints_.hold_at(kPitch, Quantity{});
  }
  if (descends(next) && state_ != next) {
    for (const std::size_t axis : {kElevation, kTravel}) {
      const bool closed = (axes() & (1U << axis)) != 0U;
      setpoints_.hold_at(axis, closed ? setpoints_.of(axis).angle_rad : seen_->angle_rad[axis]);
    }
    setpoints_.hold_at(kPitch, Quantity{});
    lands_level_ = tracking_.asks();
    quiet_ticks_ = 0;
  }
  if (next == State::fault) {
    open_ = {};
  } else if (next != State::emergency_landing) {
    fault_ = Fault::none;
  }
  if (next != state_) {
    entered_tick_ = seen_->tick;
    if (cause != Trigger::touchdown) {
      cause_ = cause;
    }
    event(Event::state, code(next), code(cause), 0.0F);
  }
  state_ = next;
}

void Supervisor::end_excitation() {
  if (exciter_.running()) {
    event(Event::excitation_end, code(exciter_.kind()), 0, 0.0F);
    exciter_.stop();
  }
}

void Supervisor::trip(Fault fault, float value, Trigger cause) {
  trigger(cause);
  fault_ = fault;
  event(Event::fault, code(fault), code(cause), value);
}

Reply Supervisor::refuse_state() const { return {Result::bad_state, code(state_), 0.0F}; }

Reply Supervisor::plain(Trigger cause) {
  return trigger(cause) ? Reply{Result::ok, code(state_), 0.0F} : refuse_state();
}

Reply Supervisor::execute(const link::Request& request) {
  switch (request.id) {
    case MessageId::arm:
      return arm();
    case MessageId::stop:
      return plain(Trigger::stop);
    case MessageId::control:
      return control(request.as<link::ControlMessage>());
    case MessageId::stream: {
      const Reply reply = plain(Trigger::stream);
      if (reply.result == Result::ok) {
        open_ = seen_->acted;
        follows_ = false;
        axes_ = kAllAxes;
        fresh_tick_ = seen_->tick;
        voltage_end_tick_ = seen_->tick + limits_->voltage_valid_max_ticks;
      }
      return reply;
    }
    case MessageId::land:
      return plain(Trigger::land);
    case MessageId::excite:
      return excite(request.as<link::ExciteMessage>());
    case MessageId::excite_stop:
      end_excitation();
      return {Result::ok, 0, 0.0F};
    case MessageId::clear_fault:
      if (seen_->hardware_stop && state_ == State::fault) {
        return {Result::check_failed, code(Fault::hardware_stop), 0.0F};
      }
      return plain(Trigger::clear);
    default:
      return {Result::unknown_command, 0, 0.0F};
  }
}

Reply Supervisor::arm() {
  if (next_state(state_, Trigger::arm) == kRefused) {
    return refuse_state();
  }
  const Verdict verdict = check_before_arming(*seen_, *limits_);
  if (verdict.fault != Fault::none) {
    return {Result::check_failed, code(verdict.fault), verdict.value};
  }
  for (std::size_t axis = 0; axis < kAxisCount; ++axis) {
    at_arming_.illegal[axis] = seen_->illegal[axis];
  }
  at_arming_.overruns = seen_->overruns;
  open_ = {};
  axes_ = 0;
  return plain(Trigger::arm);
}

Reply Supervisor::control(const link::ControlMessage& message) {
  const std::uint8_t wanted = message.axes;
  const bool travel_alone =
      (wanted & link::axes::travel) != 0U && (wanted & link::axes::pitch) == 0U;
  if ((wanted & ~kAllAxes) != 0U || travel_alone) {
    return bad_value(0, static_cast<float>(wanted));
  }
  if (!within(message.front_V, limits_->motor_min_V, limits_->motor_max_V)) {
    return bad_value(1, message.front_V);
  }
  if (!within(message.back_V, limits_->motor_min_V, limits_->motor_max_V)) {
    return bad_value(2, message.back_V);
  }
  const auto closing = static_cast<std::uint8_t>(wanted & ~axes());
  if (!trigger(wanted != 0U ? Trigger::close_loop : Trigger::open_loop)) {
    return refuse_state();
  }
  for (std::size_t axis = 0; axis < kAxisCount; ++axis) {
    if ((closing & (1U << axis)) != 0U) {
      setpoints_.hold_at(axis, seen_->angle_rad[axis]);
    }
  }
  axes_ = wanted;
  open_ = {control::quantity_of(message.front_V), control::quantity_of(message.back_V)};
  fresh_tick_ = seen_->tick;
  return {Result::ok, code(state_), 0.0F};
}

Reply Supervisor::excite(const link::ExciteMessage& message) {
  if (state_ != State::closed_loop && state_ != State::open_loop && state_ != State::streamed) {
    return refuse_state();
  }
  const auto kind = static_cast<link::Excitation>(message.kind);
  if (message.kind == 0U || message.kind >= link::kExcitationCount) {
    return bad_value(0, static_cast<float>(message.kind));
  }
  if (magnitude(message.front_V) > limits_->excitation_max_V) {
    return bad_value(1, message.front_V);
  }
  if (magnitude(message.back_V) > limits_->excitation_max_V) {
    return bad_value(2, message.back_V);
  }
  const bool sweeps = kind == link::Excitation::chirp || kind == link::Excitation::multisine;
  if (sweeps && !within(message.start_Hz, 0.0F, kNyquist_Hz)) {
    return bad_value(3, message.start_Hz);
  }
  if ((sweeps && !within(message.stop_Hz, message.start_Hz, kNyquist_Hz)) ||
      (kind == link::Excitation::prbs && !within(message.stop_Hz, 0.01F, kNyquist_Hz))) {
    return bad_value(4, message.stop_Hz);
  }
  if (!within(message.duration_s, control::kTick_s, limits_->excitation_max_s)) {
    return bad_value(5, message.duration_s);
  }
  if (kind == link::Excitation::prbs && message.seed == 0U) {
    return bad_value(6);
  }
  end_excitation();
  exciter_.start(message);
  return {Result::ok, message.kind, 0.0F};
}

void Supervisor::take_stream(const link::StreamValue& value) {
  if (value.id == MessageId::setpoint) {
    take_setpoint(value.setpoint);
  } else if (value.id == MessageId::voltages) {
    take_voltages(value.voltages);
  } else if (state_ == State::streamed) {
    following_rad_[kElevation] = control::quantity_of(value.following.elevation_rad);
    following_rad_[kPitch] = control::quantity_of(value.following.pitch_rad);
    following_rad_[kTravel] = control::quantity_of(value.following.travel_rad);
    follows_ = true;
  }
}

void Supervisor::take_setpoint(const link::SetpointMessage& message) {
  if (state_ != State::closed_loop && state_ != State::hold) {
    reject(Result::bad_state);
    return;
  }
  const Quantity target_rad[kAxisCount] = {control::quantity_of(message.elevation_rad),
                                           control::quantity_of(message.pitch_rad),
                                           control::quantity_of(message.travel_rad)};
  if (!setpoints_.aim(target_rad, message.apply_tick, seen_->tick, *bounds_)) {
    reject(Result::bad_value);
    return;
  }
  count_accepted();
  if (trigger(Trigger::setpoint_fresh)) {
    event(Event::setpoint_fresh, 0, 0, 0.0F);
  }
}

void Supervisor::take_voltages(const link::VoltagesMessage& message) {
  if (state_ != State::streamed) {
    reject(Result::bad_state);
    return;
  }
  if (!within(message.front_V, limits_->motor_min_V, limits_->motor_max_V) ||
      !within(message.back_V, limits_->motor_min_V, limits_->motor_max_V)) {
    reject(Result::bad_value);
    return;
  }
  open_ = {control::quantity_of(message.front_V), control::quantity_of(message.back_V)};
  const std::uint32_t valid_ticks = message.valid_ms < limits_->voltage_valid_max_ticks
                                        ? message.valid_ms
                                        : limits_->voltage_valid_max_ticks;
  voltage_end_tick_ = seen_->tick + valid_ticks;
  count_accepted();
}

void Supervisor::count_accepted() {
  ++accepted_[bucket_];
  fresh_tick_ = seen_->tick;
  rate_when_fresh_Hz_ = setpoint_rate_Hz();
}

void Supervisor::reject(Result why) {
  ++refused_streams_;
  // Streaming during a landing is no error: the host may not know of the landing yet.
  if (descends(state_) || !passed(seen_->tick, next_reject_event_tick_)) {
    return;
  }
  next_reject_event_tick_ = seen_->tick + kRejectEvery_ticks;
  event(Event::setpoint_rejected, code(why), 0, 0.0F);
}

void Supervisor::check_limits() {
  const Verdict verdict = check_flight(*seen_, at_arming_, *limits_);
  if (verdict.fault != Fault::none) {
    trip(verdict.fault, verdict.value);
  }
}

// Not in open loop: on a bench, people may hold the arm or clamp an axis on purpose.
void Supervisor::check_tracking() {
  if (!motors_enabled() || state_ == State::armed || state_ == State::open_loop) {
    tracking_.restart();
    return;
  }
  const std::uint8_t closed = axes();
  Tracked tracked{*seen_, {}, closed, state_ == State::streamed ? kAllAxes : closed, false, false};
  tracked.setpoint_rad[kElevation] = setpoints_.angle_rad(kElevation);
  tracked.setpoint_rad[kPitch] = seen_->pitch_setpoint_rad;
  tracked.setpoint_rad[kTravel] = setpoints_.angle_rad(kTravel);
  tracked.descends = descends(state_);
  if (tracked.descends) {
    // Landing aims below the table and has a time limit of its own.
    tracked.closed = static_cast<std::uint8_t>(closed & ~link::axes::elevation);
  }
  // An uploaded law decides on its voltages itself.
  tracked.may_ask = (closed & link::axes::travel) != 0U && !tracked.descends && !seen_->law_busy;
  Verdict verdict{Fault::none, 0.0F};
  if (Tracking::is_turn_to_ask(seen_->tick)) {
    verdict = tracking_.ask(tracked, *tracking_limits_);
    if (tracking_.news() != link::Probe::none) {
      event(Event::travel_probe, code(tracking_.news()), 0,
            tracking_.probe().tilt_rad().to_float() * control::kDegPerRad);
    }
  } else {
    verdict = tracking_.check(tracked, *tracking_limits_);
  }
  if (verdict.fault == Fault::none) {
    return;
  }
  const bool travel =
      verdict.fault == Fault::travel_following || verdict.fault == Fault::travel_motionless;
  trip(verdict.fault, verdict.value, travel ? Trigger::travel_lost : Trigger::trip);
}

void Supervisor::check_ages() {
  const std::uint32_t stream_age_ticks = seen_->tick - fresh_tick_;
  switch (state_) {
    case State::armed:
      if (seen_->link_age_ticks > limits_->land_ticks) {
        trigger(Trigger::stale_land);
      }
      break;
    case State::open_loop:
      if (seen_->link_age_ticks > limits_->hold_ticks) {
        trigger(Trigger::stale_hold);
      }
      break;
    case State::closed_loop:
      if (stream_age_ticks > limits_->hold_ticks) {
        trigger(Trigger::stale_hold);
        event(Event::setpoint_stale, 0, 0, static_cast<float>(rate_when_fresh_Hz_));
      }
      break;
    case State::streamed:
      if (passed(seen_->tick, voltage_end_tick_)) {
        trigger(Trigger::stale_hold);
        event(Event::setpoint_stale, 0, 0, static_cast<float>(rate_when_fresh_Hz_));
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

bool Supervisor::touched_down() {
  const bool quiet = seen_->angle_rad[kElevation] - limits_->rest_rad < kTouchdown_rad &&
                     magnitude(seen_->rate_rad_s[kElevation]) < kTouchdown_rad_s;
  quiet_ticks_ = quiet ? quiet_ticks_ + 1U : 0U;
  return quiet_ticks_ >= kTouchdown_ticks;
}

void Supervisor::advance() {
  if (passed(seen_->tick, bucket_end_tick_)) {
    bucket_end_tick_ = seen_->tick + kBucket_ticks;
    bucket_ = bucket_ + 1U < kRateBuckets ? bucket_ + 1U : 0U;
    accepted_[bucket_] = 0;
  }
  if (motors_enabled()) {
    check_limits();
  }
  check_tracking();
  check_ages();

  levels_ = false;
  switch (state_) {
    case State::closed_loop:
    case State::hold:
      setpoints_.advance(*bounds_);
      break;
    case State::landing:
    case State::emergency_landing:
      setpoints_.descend(*bounds_, limits_->rest_rad - kBelowRest_rad);
      levels_ = lands_level_ || seen_->tick - entered_tick_ > limits_->landing_timeout_ticks / 2U;
      if (touched_down()) {
        trigger(Trigger::touchdown);
      } else if (seen_->tick - entered_tick_ > limits_->landing_timeout_ticks) {
        trip(Fault::landing_timeout,
             static_cast<float>(seen_->tick - entered_tick_) * control::kTick_s);
      }
      break;
    default:
      setpoints_.start_at(seen_->angle_rad);
      break;
  }
}

}  // namespace heli::flight
