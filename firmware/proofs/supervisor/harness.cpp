// One tick, one command and one streamed value, from any state of the supervisor.
#include "any.hpp"
#include "flight/supervisor.cpp"
#include "no_interrupt.hpp"
#include "supervisor/invariant.hpp"

using heli::flight::descends;
using heli::flight::Limits;
using heli::flight::motors_enabled;
using heli::flight::Observation;
using heli::flight::SetpointLimits;
using heli::flight::Supervisor;
using heli::flight::TrackingLimits;
using heli::flight::Verdict;
using heli::link::Fault;
using heli::link::MessageId;
using heli::link::State;
using heli::proofs::any;
using heli::proofs::holds;

namespace heli::flight {

// Contracts: what stops a flight or forbids arming, and any other limit that is broken.
Verdict check_flight(const Observation& s, const AtArming&, const Limits&, std::uint8_t) {
  Verdict verdict{any<Fault>(), 0.0F};
  ASSUME(!s.hardware_stop || verdict.fault == Fault::hardware_stop);
  ASSUME(s.hardware_stop || s.overload_edges == 0U || verdict.fault == Fault::encoder_overload);
  return verdict;
}
void update_floor(AtArming& before, const Observation&, const Limits&) {
  before.lifted_off = any<bool>();
  before.floor_rad = any<Quantity>();
}
Verdict check_before_arming(const Observation& s, const Limits& l, std::uint8_t) {
  Verdict verdict{any<Fault>(), 0.0F};
  ASSUME((!s.hardware_stop && s.overload_edges == 0U && s.params_usable && l.params_consistent) ||
         verdict.fault != Fault::none);
  return verdict;
}

}  // namespace heli::flight

namespace {

heli::link::Link the_link;
Observation seen;
Limits limits;
SetpointLimits bounds;
TrackingLimits tracking;

// Any observation, any limits, and any state that satisfies the invariant.
void put_in_any_state(Supervisor& s) {
  seen.tick = any<std::uint32_t>();
  seen.angle_rad[heli::kElevation] = any<heli::control::Quantity>();
  seen.rate_rad_s[heli::kElevation] = any<heli::control::Quantity>();
  seen.hardware_stop = any<bool>();
  seen.overload_edges = any<std::uint32_t>();
  seen.overruns = any<std::uint32_t>();
  seen.link_age_ticks = any<std::uint32_t>();
  seen.params_usable = any<bool>();
  seen.law_busy = any<bool>();
  limits.hold_ticks = any<std::uint32_t>();
  limits.land_ticks = any<std::uint32_t>();
  limits.landing_timeout_ticks = any<std::uint32_t>();
  limits.blind_landing_ticks = any<std::uint32_t>();
  limits.voltage_valid_max_ticks = any<std::uint32_t>();
  limits.params_consistent = any<bool>();
  s.observe(seen, limits, bounds, tracking);
  s.state_ = any<State>();
  s.fault_ = any<Fault>();
  s.cause_ = any<heli::link::Trigger>();
  s.axes_ = any<std::uint8_t>();
  s.host_setpoints_known_ = any<bool>();
  s.state_entered_tick_ = any<std::uint32_t>();
  s.last_stream_tick_ = any<std::uint32_t>();
  s.voltage_end_tick_ = any<std::uint32_t>();
  s.rest_ticks_ = any<std::uint32_t>();
  s.landing_holds_pitch_level_ = any<bool>();
  s.hang_ticks_ = any<std::uint32_t>();
  s.blind_descent_idles_ = any<bool>();
  s.sinks_at_take_off_ = any<bool>();
  s.trusted_axes_ = any<std::uint8_t>();
  s.at_arming_.lifted_off = any<bool>();
  s.bucket_ = any<std::uint32_t>();
  s.bucket_end_tick_ = any<std::uint32_t>();
  s.exciter_.kind_ = any<heli::link::Excitation>();
  ASSUME(holds(s));
}

}  // namespace

// One control tick.
void step_tick() {
  Supervisor s(the_link);
  put_in_any_state(s);
  const State before = s.state_;
  const Fault fault = s.fault_;
  const std::uint32_t entered_tick = s.state_entered_tick_;
  const std::uint8_t trusted_axes = s.trusted_axes_;
  const std::uint32_t stream_age_ticks = seen.tick - s.last_stream_tick_;
  const bool voltages_end = static_cast<std::int32_t>(seen.tick - s.voltage_end_tick_) >= 0;

  s.advance();

  const State after = s.state_;
  CLAIM(holds(s), "the invariant is kept");
  CLAIM(motors_enabled(before) || after == before, "no tick starts a motor");
  CLAIM(after != State::armed || before == State::armed, "no tick arms");
  CLAIM(before != State::fault || (after == before && s.fault_ == fault), "a fault is latched");
  CLAIM((s.trusted_axes_ & ~trusted_axes) == 0, "a lost axis is not trusted again in this flight");
  CLAIM(after != State::emergency_landing || (s.axes() & ~s.trusted_axes_) == 0,
        "no loop is closed over a lost axis");
  CLAIM(!motors_enabled(before) || (!seen.hardware_stop && seen.overload_edges == 0U) ||
            after == State::fault,
        "a stopped board or a blind one is off in the same tick");
  CLAIM(before != State::closed_loop || stream_age_ticks <= limits.hold_ticks ||
            after != State::closed_loop,
        "stale setpoints end the flight along them");
  CLAIM(before != State::streamed || !voltages_end || after != State::streamed,
        "stale voltages act no longer");
  CLAIM(before != State::hold || stream_age_ticks <= limits.land_ticks || after != State::hold,
        "a hold is bounded in time");
  CLAIM(before != State::open_loop || seen.link_age_ticks <= limits.hold_ticks ||
            !motors_enabled(after),
        "a bench without a host is off");
  CLAIM(
      before != State::armed || seen.link_age_ticks <= limits.land_ticks || !motors_enabled(after),
      "nothing stays armed without a host");
  CLAIM(!descends(before) || before != after || s.state_entered_tick_ == entered_tick,
        "a landing does not begin again");
  CLAIM(!descends(before) || !descends(after) || before != after ||
            seen.tick - entered_tick <= limits.landing_timeout_ticks ||
            seen.tick - entered_tick <= limits.blind_landing_ticks,
        "a landing is bounded in time");
}

// One command of the host.
void step_command() {
  Supervisor s(the_link);
  put_in_any_state(s);
  const State before = s.state_;
  const Fault fault = s.fault_;
  const auto request = any<heli::link::Request>();

  s.execute(request);

  const State after = s.state_;
  CLAIM(holds(s), "the invariant is kept");
  CLAIM(motors_enabled(before) || !motors_enabled(after) ||
            (before == State::idle && after == State::armed && request.id == MessageId::arm &&
             !seen.hardware_stop && seen.params_usable && limits.params_consistent),
        "motors start only by arming, from idle and when all is well");
  CLAIM(request.id != MessageId::stop || !motors_enabled(after), "stop ends in off");
  CLAIM(before != State::fault || after == before ||
            (after == State::idle && request.id == MessageId::clear_fault && !seen.hardware_stop),
        "only a clear ends a fault");
  CLAIM(before != State::fault || after != before || s.fault_ == fault, "a fault keeps its reason");
}

// One streamed value of the host.
void step_stream() {
  Supervisor s(the_link);
  put_in_any_state(s);
  const State before = s.state_;

  s.take_stream(any<heli::link::StreamValue>());

  CLAIM(holds(s), "the invariant is kept");
  CLAIM(s.state_ == before || (before == State::hold && s.state_ == State::closed_loop),
        "a streamed value only ends a hold");
}
