// A command or streamed voltage of any content, from any state of the supervisor; and a parameter.
#include <cfloat>
#include <cmath>

#include "any.hpp"
#include "flight/supervisor.cpp"
#include "no_interrupt.hpp"

// Contract of trunc(): any number; the last one is remembered.
float whole;
namespace std {
inline float any_trunc(float) {
  whole = heli::proofs::any<float>();
  return whole;
}
}  // namespace std
#define trunc any_trunc

// Two rows of any content in place of the declared table: the same comparisons, and fewer for the
// solver.
namespace heli::link {
inline constexpr std::size_t kTwoParams = 2;
ParamInfo two_rows[kTwoParams];
}  // namespace heli::link
#define kParamCount kTwoParams
#define kParams two_rows
#include "params/params.cpp"
#undef kParams
#undef kParamCount
#undef trunc

using heli::control::quantity_of;
using heli::flight::Limits;
using heli::flight::Observation;
using heli::flight::SetpointLimits;
using heli::flight::Supervisor;
using heli::flight::TrackingLimits;
using heli::flight::Verdict;
using heli::link::ControlMessage;
using heli::link::Excitation;
using heli::link::ExciteMessage;
using heli::link::Result;
using heli::link::State;
using heli::link::VoltagesMessage;
using heli::proofs::any;

// Contracts: limits find anything. No step here comes to them.
Verdict heli::flight::check_flight(const Observation&, const AtArming&, const Limits&,
                                   std::uint8_t) {
  return {any<link::Fault>(), 0.0F};
}
Verdict heli::flight::check_before_arming(const Observation&, const Limits&, std::uint8_t) {
  return {any<link::Fault>(), 0.0F};
}
void heli::flight::update_floor(AtArming&, const Observation&, const Limits&) {}

namespace {

namespace axes = heli::link::axes;

heli::link::Link the_link;
Observation seen;
Limits limits;
SetpointLimits bounds;
TrackingLimits tracking;

bool finite(float value) { return value >= -FLT_MAX && value <= FLT_MAX; }
bool in(float value, float least, float most) { return value >= least && value <= most; }

// Any state, any tick and any finite limits.
void put_in_any_state(Supervisor& s) {
  seen.tick = any<std::uint32_t>();
  limits.voltage_valid_max_ticks = any<std::uint32_t>();
  limits.motor_min_V = any<float>();
  limits.motor_max_V = any<float>();
  limits.excitation_max_V = any<float>();
  limits.excitation_max_s = any<float>();
  ASSUME(finite(limits.motor_min_V) && finite(limits.motor_max_V));
  ASSUME(finite(limits.excitation_max_V) && finite(limits.excitation_max_s));
  s.observe(seen, limits, bounds, tracking);
  s.state_ = any<State>();
  s.axes_ = any<std::uint8_t>();
  s.open_voltages_.front_V = any<heli::control::Quantity>();
  s.open_voltages_.back_V = any<heli::control::Quantity>();
  s.voltage_end_tick_ = any<std::uint32_t>();
  s.refused_streams_ = any<std::uint32_t>();
  s.exciter_.kind_ = any<Excitation>();
  ASSUME(static_cast<std::size_t>(s.state_) < heli::link::kStateCount);
}

// What drives the motors, and in which state: a copy, to compare it after the call.
struct Driven {
  State state;
  std::uint8_t axes;
  std::int32_t front;
  std::int32_t back;
  Excitation excitation;

  explicit Driven(const Supervisor& s)
      : state(s.state_),
        axes(s.axes_),
        front(s.open_voltages_.front_V.raw_),
        back(s.open_voltages_.back_V.raw_),
        excitation(s.exciter_.kind_) {}
  bool is(const Supervisor& s) const {
    return state == s.state_ && axes == s.axes_ && front == s.open_voltages_.front_V.raw_ &&
           back == s.open_voltages_.back_V.raw_ && excitation == s.exciter_.kind_;
  }
};

// What the declaration allows: known axes, travel only together with pitch, voltages within the
// motor's.
bool in_range(const ControlMessage& m) {
  const bool known = (m.axes & ~(axes::elevation | axes::pitch | axes::travel)) == 0;
  const bool travel_alone = (m.axes & axes::travel) != 0 && (m.axes & axes::pitch) == 0;
  return known && !travel_alone && in(m.front_V, limits.motor_min_V, limits.motor_max_V) &&
         in(m.back_V, limits.motor_min_V, limits.motor_max_V);
}

// The same for an excitation; which numbers count depends on its kind.
bool in_range(const ExciteMessage& m) {
  constexpr float kMost_Hz = 500.0F;
  const auto kind = static_cast<Excitation>(m.kind);
  const bool has_frequency_band = kind == Excitation::chirp || kind == Excitation::multisine;
  return m.kind > 0 && m.kind < heli::link::kExcitationCount &&
         in(m.front_V, -limits.excitation_max_V, limits.excitation_max_V) &&
         in(m.back_V, -limits.excitation_max_V, limits.excitation_max_V) &&
         (!has_frequency_band ||
          (in(m.start_Hz, 0.0F, kMost_Hz) && in(m.stop_Hz, m.start_Hz, kMost_Hz))) &&
         (kind != Excitation::prbs || (in(m.stop_Hz, 0.01F, kMost_Hz) && m.seed != 0)) &&
         in(m.duration_s, 0.001F, limits.excitation_max_s);
}

}  // namespace

// One command that closes loops or sets voltages.
void step_control() {
  Supervisor s(the_link);
  put_in_any_state(s);
  const Driven before(s);
  const auto message = any<ControlMessage>();

  const heli::link::Reply reply = s.control(message);

  CLAIM(reply.result != Result::ok || in_range(message), "what is accepted is in range");
  CLAIM(reply.result == Result::ok || before.is(s), "what is refused changes nothing");
}

// One command that starts an excitation.
void step_excite() {
  Supervisor s(the_link);
  put_in_any_state(s);
  const Driven before(s);
  const auto message = any<ExciteMessage>();
  ASSUME(finite(message.front_V) && finite(message.back_V));

  const heli::link::Reply reply = s.excite(message);

  CLAIM(reply.result != Result::ok || in_range(message), "what is accepted is in range");
  CLAIM(reply.result == Result::ok || before.is(s), "what is refused changes nothing");
}

// One streamed pair of voltages.
void step_voltages() {
  Supervisor s(the_link);
  put_in_any_state(s);
  const Driven before(s);
  const std::uint32_t refused = s.refused_streams_;
  const std::uint32_t end_tick = s.voltage_end_tick_;
  const auto message = any<VoltagesMessage>();

  s.take_voltages(message);

  const bool accepted = s.refused_streams_ == refused;
  CLAIM(!accepted || (s.state_ == State::streamed &&
                      in(message.front_V, limits.motor_min_V, limits.motor_max_V) &&
                      in(message.back_V, limits.motor_min_V, limits.motor_max_V)),
        "what is accepted is in range");
  CLAIM(!accepted || s.voltage_end_tick_ - seen.tick <= limits.voltage_valid_max_ticks,
        "no voltage acts longer than a parameter allows");
  CLAIM(accepted || (before.is(s) && s.voltage_end_tick_ == end_tick),
        "what is refused changes nothing");
}

// One parameter of any number and value, with a table of any content.
void step_parameter() {
  for (heli::link::ParamInfo& row : heli::link::two_rows) {
    row = any<heli::link::ParamInfo>();
  }
  const auto which = any<heli::link::Param>();
  const auto value = any<float>();

  const bool accepted = heli::params::Params::check(which, value) == Result::ok;

  const auto index = static_cast<std::size_t>(which);
  CLAIM(!accepted || index < heli::link::kTwoParams, "it is a parameter");
  if (accepted) {
    const heli::link::ParamInfo& info = heli::link::two_rows[index];
    CLAIM(in(value, info.min, info.max), "it is in its range");
    CLAIM(!info.nonzero || value != 0.0F, "it is not zero where zero is forbidden");
    CLAIM(!info.integer || whole == value, "it is whole where it must be");
  }
}

// A range of voltages in volts is one of quantities too.
void step_number() {
  const auto a = any<float>();
  const auto b = any<float>();
  ASSUME(a <= b);
  CLAIM(quantity_of(a).raw() <= quantity_of(b).raw(), "a quantity is larger for a larger number");
}
