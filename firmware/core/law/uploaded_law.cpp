#include "law/uploaded_law.hpp"

#include "control/math.hpp"
#include "conversion.hpp"

namespace heli::law {

using control::clamp;
using control::product;
using control::Whole;
using link::LawInput;
using link::Param;

namespace {

using Wire = control::Fixed<14>;

constexpr float kSetpointPerUnit[kAxisCount] = {
    link::kElevationSetpointPerUnit, link::kPitchSetpointPerUnit, link::kTravelSetpointPerUnit};
constexpr Wire kSetpointWire[kAxisCount] = {
    Wire::of(kSetpointPerUnit[0]), Wire::of(kSetpointPerUnit[1]), Wire::of(kSetpointPerUnit[2])};
// Size of the channel's step: 1e-5 rad, with a relative error of 1e-8.
using Step = control::Fixed<43>;
constexpr Step kSetpointUnit_rad[kAxisCount] = {Step::of(1.0F / kSetpointPerUnit[0]),
                                                Step::of(1.0F / kSetpointPerUnit[1]),
                                                Step::of(1.0F / kSetpointPerUnit[2])};
constexpr float kSignalPerUnit[link::kLawSignals] = {link::kSignal1PerUnit, link::kSignal2PerUnit,
                                                     link::kSignal3PerUnit, link::kSignal4PerUnit};

Quantity volts(std::int32_t raw) {
  constexpr auto kUnit_V = control::Fixed<40>::of(1.0F / link::kFrontPerUnit);
  return product<24>(Whole::from_raw(raw), kUnit_V);
}

static_assert(link::kFrontPerUnit == link::kBackPerUnit, "both voltages have one scale");

// Returns the index of the first output that is not finite, new states included.
std::uint32_t first_not_finite(const Tape& tape) {
  const std::uint32_t count = tape.shape().outputs();
  std::uint32_t place = 0;
  while (place + 1U < count && is_finite(tape.output(place))) {
    ++place;
  }
  return place;
}

}  // namespace

void UploadedLaw::derive(const params::Params& params, Bank bank) {
  Limits& l = limits_[bank];
  l.guard = guard_limits_of(params);
  l.recovery = recovery_limits_of(params);
  const Param cutoffs[kAxisCount] = {Param::elevation_filter_Hz, Param::pitch_filter_Hz,
                                     Param::travel_filter_Hz};
  for (std::size_t axis = 0; axis < kAxisCount; ++axis) {
    l.smoothing[axis] = control::Share::of(smoothing_of(params.get(cutoffs[axis])));
  }
  l.bumpless_keep = control::bumpless_keep_of(params);
  l.motor_min_V = Quantity::of(params.get(Param::motor_min_V));
  l.motor_max_V = Quantity::of(params.get(Param::motor_max_V));
  l.differential_max_V = Quantity::of(params.get(Param::differential_max_V));
}

link::Reply UploadedLaw::engage(const Acted& acted) {
  if (flying()) {
    return {};
  }
  if (tape_.state() != LawState::ready) {
    return {link::Result::bad_law, static_cast<std::uint8_t>(LawError::not_loaded), 0.0F};
  }
  tape_.restart();
  guard_.restart();
  recovery_.stop();
  phase_ = 0;
  called_ = false;
  acted_ = acted;
  before_.front_V = volts(acted.front_raw);
  before_.back_V = volts(acted.back_raw);
  output_ = before_;
  for (std::size_t axis = 0; axis < kAxisCount; ++axis) {
    setpoint_rate_[axis].restart();
    setpoint_acceleration_[axis].restart();
  }
  for (std::int32_t& raw : signal_raw_) {
    raw = 0;
  }
  choose_signals();
  tape_.fly(true);
  busy_ = true;
  event_ = {0, static_cast<std::uint8_t>(link::Event::law_engaged), 0, 0,
            static_cast<float>(tape_.shape().divisor)};
  event_waits_ = true;
  return {};
}

link::Reply UploadedLaw::set_parameter(const link::LawSetMessage& message) {
  const LawState state = tape_.state();
  if (state != LawState::ready && state != LawState::flying) {
    return {link::Result::bad_law, static_cast<std::uint8_t>(LawError::not_loaded), 0.0F};
  }
  if (!tape_.set_parameter(message.index, bits_of(message.value))) {
    return {link::Result::bad_law, static_cast<std::uint8_t>(LawError::no_such_parameter),
            static_cast<float>(tape_.shape().parameters)};
  }
  return {link::Result::ok, message.index, message.value};
}

bool UploadedLaw::recover(ControlInput& in, Bank bank) {
  const Limits& limits = limits_[bank];
  const Quantity lift_V =
      spare_lift_V(before_.front_V, before_.back_V, in.angle_rad[kElevation], limits.guard);
  recovery_.update(in, lift_V, before_.front_V - before_.back_V, limits.recovery);
  return recovery_.begins();
}

void UploadedLaw::hand_over(Takeover reason, float value) {
  tape_.fly(false);
  recovery_.start();
  event_ = {0, static_cast<std::uint8_t>(link::Event::law_taken_over),
            static_cast<std::uint8_t>(reason), 0, value};
  event_waits_ = true;
}

bool UploadedLaw::poll_event(link::EventMessage& event) {
  if (!event_waits_) {
    return false;
  }
  event_waits_ = false;
  event = event_;
  return true;
}

// If a law logs its own setpoint, a free signal logs the setpoint that the board gave it: without
// that, the flight could not be replayed from its log.
void UploadedLaw::choose_signals() {
  std::uint32_t free = tape_.shape().signals;
  for (std::uint32_t axis = 0; axis < kAxisCount; ++axis) {
    const auto given = static_cast<std::uint32_t>(LawInput::elevation_setpoint_rad) + axis;
    const std::uint32_t reads = tape_.inputs_read() & (1U << given | moving_inputs(axis));
    follows_given_[axis] = tape_.passes_input(Shape::kFirstSetpoint + axis, given);
    given_signal_[axis] = link::kLawSignals;
    if (!follows_given_[axis] && reads != 0U && free < link::kLawSignals) {
      given_signal_[axis] = free++;
    }
  }
}

// Inputs are rounded as the log rounds them, so that a flight can be replayed bit for bit.
void UploadedLaw::read_inputs(const ControlInput& in, const Limits& limits) {
  const std::uint32_t read = tape_.inputs_read();
  const auto give = [this, read](LawInput first, std::size_t axis, Quantity value) {
    const std::size_t input = static_cast<std::size_t>(first) + axis;
    if ((read >> input & 1U) != 0U) {
      tape_.set_input(input, from_quantity(value));
    }
  };
  const bool begins = phase_ == 0U;
  for (std::size_t axis = 0; axis < kAxisCount; ++axis) {
    given_raw_[axis] = product<0>(in.setpoint_rad[axis], kSetpointWire[axis]).raw();
    const Quantity setpoint_rad =
        product<24>(Whole::from_raw(given_raw_[axis]), kSetpointUnit_rad[axis]);
    Quantity setpoint_rad_s;
    Quantity setpoint_rad_s2;
    if ((read & moving_inputs(static_cast<std::uint32_t>(axis))) != 0U) {
      setpoint_rad_s = setpoint_rate_[axis].update(setpoint_rad, limits.smoothing[axis]);
      setpoint_rad_s2 = setpoint_acceleration_[axis].update(setpoint_rad_s, limits.smoothing[axis]);
    }
    if (begins) {
      give(LawInput::elevation_rad, axis, in.angle_rad[axis]);
      give(LawInput::elevation_rad_s, axis, in.rate_rad_s[axis]);
      give(LawInput::elevation_setpoint_rad, axis, setpoint_rad);
      give(LawInput::elevation_setpoint_rad_s, axis, setpoint_rad_s);
      give(LawInput::elevation_setpoint_rad_s2, axis, setpoint_rad_s2);
    }
  }
  if (begins) {
    give(LawInput::front_V, 0, volts(acted_.front_raw));
    give(LawInput::back_V, 0, volts(acted_.back_raw));
  }
}

GuardVerdict UploadedLaw::read_outputs(const Limits& limits) {
  const Shape& shape = tape_.shape();
  for (std::uint32_t place = 0; place < Shape::kFirstSignal + shape.signals; ++place) {
    if (!is_finite(tape_.output(place))) {
      return {Takeover::not_finite, static_cast<float>(place)};
    }
  }
  const auto volts_of = [this, &limits](std::size_t place) {
    return clamp(to_quantity(tape_.output(place)), limits.motor_min_V, limits.motor_max_V);
  };
  const LawOutput fresh{volts_of(0), volts_of(1),
                        to_quantity(tape_.output(Shape::kFirstSetpoint + kPitch))};
  if (called_) {
    const Quantity front_V = control::magnitude(fresh.front_V - output_.front_V);
    const Quantity back_V = control::magnitude(fresh.back_V - output_.back_V);
    const Quantity jump_V = front_V > back_V ? front_V : back_V;
    if (jump_V > limits.guard.jump_max_V) {
      return {Takeover::voltage_jump, jump_V.to_float()};
    }
  }
  fresh_ = !called_;
  called_ = true;
  output_ = fresh;
  for (std::size_t axis = 0; axis < kAxisCount; ++axis) {
    if (!follows_given_[axis]) {
      const Quantity own_rad = to_quantity(tape_.output(Shape::kFirstSetpoint + axis));
      setpoint_raw_[axis] = product<0>(own_rad, kSetpointWire[axis]).raw();
    }
  }
  for (std::uint32_t k = 0; k < shape.signals; ++k) {
    const Bits signal = tape_.output(Shape::kFirstSignal + k);
    signal_raw_[k] = to_whole(multiply(signal, bits_of(kSignalPerUnit[k])));
  }
  // A state that is not finite would reach the voltages only at the next call.
  if (!tape_.commit_states()) {
    return {Takeover::not_finite, static_cast<float>(first_not_finite(tape_))};
  }
  return {};
}

void UploadedLaw::limit(ControlOutput& out, const Limits& limits) const {
  const Quantity front_V = out.front_V;
  const Quantity back_V = out.back_V;
  const Quantity middle_V = (front_V + back_V).half();
  const Quantity half_V =
      clamp(front_V - back_V, -limits.differential_max_V, limits.differential_max_V).half();
  out.front_V = clamp(middle_V + half_V, limits.motor_min_V, limits.motor_max_V);
  out.back_V = clamp(middle_V - half_V, limits.motor_min_V, limits.motor_max_V);
  // Halving loses half a bit.
  constexpr Quantity kSame_V = Quantity::from_raw(2);
  out.front_saturated = control::magnitude(out.front_V - front_V) > kSame_V;
  out.back_saturated = control::magnitude(out.back_V - back_V) > kSame_V;
}

bool UploadedLaw::update(const ControlInput& in, Bank bank, ControlOutput& out) {
  const Limits& limits = limits_[bank];
  read_inputs(in, limits);
  // A call of the law is spread over several ticks; its outputs change when it ends.
  GuardVerdict judgement{};
  fresh_ = false;
  if (phase_ < tape_.ticks() && tape_.run(phase_)) {
    judgement = read_outputs(limits);
  }
  // For the log. Before the first call has ended, and on axes whose setpoint the law passes on
  // unchanged, the setpoint is the one that the law is given.
  for (std::size_t axis = 0; axis < kAxisCount; ++axis) {
    if (!called_ || follows_given_[axis]) {
      setpoint_raw_[axis] = given_raw_[axis];
    }
    if (given_signal_[axis] < link::kLawSignals) {
      signal_raw_[given_signal_[axis]] = given_raw_[axis];
    }
  }
  if (!called_) {
    output_.pitch_setpoint_rad = in.angle_rad[kPitch];
  }
  if (judgement.reason == Takeover::command) {
    judgement = guard_.check(in, output_, before_, limits.guard);
  }
  if (judgement.reason != Takeover::command) {
    hand_over(judgement.reason, judgement.value);
    return false;
  }
  ++phase_;
  if (phase_ == tape_.shape().divisor) {
    phase_ = 0;
  }
  out = {};
  out.front_V = front_fade_.apply(output_.front_V, before_.front_V, fresh_, limits.bumpless_keep);
  out.back_V = back_fade_.apply(output_.back_V, before_.back_V, fresh_, limits.bumpless_keep);
  // Until the first call has ended, the motors keep their voltages.
  if (!called_) {
    out.front_V = before_.front_V;
    out.back_V = before_.back_V;
  }
  limit(out, limits);
  before_ = {out.front_V, out.back_V, output_.pitch_setpoint_rad};
  out.front_V = clamp(out.front_V + in.excitation_front_V, limits.motor_min_V, limits.motor_max_V);
  out.back_V = clamp(out.back_V + in.excitation_back_V, limits.motor_min_V, limits.motor_max_V);
  out.pitch_setpoint_rad = output_.pitch_setpoint_rad;
  return true;
}

}  // namespace heli::law
