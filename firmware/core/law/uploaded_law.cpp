// One tick of an uploaded law's flight: inputs, a part of a call, outputs, checks, voltages. A
// value in the log's units is called `raw`. Everything but derive() runs in the tick.
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

// Volts of a logged motor voltage.
Quantity volts(std::int32_t raw) {
  constexpr auto kUnit_V = control::Fixed<40>::of(1.0F / link::kFrontPerUnit);
  return product<24>(Whole::from_raw(raw), kUnit_V);
}

static_assert(link::kFrontPerUnit == link::kBackPerUnit, "both voltages have one scale");

// Returns the index of the first output that is not finite, new states included.
std::uint32_t first_not_finite(const Tape& tape) {
  const std::uint32_t count = tape.shape().outputs();
  std::uint32_t index = 0;
  while (index + 1U < count && is_finite(tape.output(index))) {
    ++index;
  }
  return index;
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

link::Reply UploadedLaw::engage(const AppliedVoltages& applied) {
  if (flying()) {
    return {};
  }
  if (tape_.state() != LawState::ready) {
    return {link::Result::bad_law, static_cast<std::uint8_t>(LawError::not_loaded), 0.0F};
  }
  // The law starts without a past, from the voltages that act now.
  tape_.restart();
  guard_.restart();
  recovery_.stop();
  phase_ = 0;
  has_output_ = false;
  applied_ = applied;
  previous_output_.front_V = volts(applied.front_raw);
  previous_output_.back_V = volts(applied.back_raw);
  output_ = previous_output_;
  for (std::size_t axis = 0; axis < kAxisCount; ++axis) {
    setpoint_rate_[axis].restart();
    setpoint_acceleration_[axis].restart();
  }
  for (std::int32_t& raw : signal_raw_) {
    raw = 0;
  }
  assign_setpoint_signals();
  tape_.fly(true);
  busy_ = true;
  event_ = {0, static_cast<std::uint8_t>(link::Event::law_engaged), 0, 0,
            static_cast<float>(tape_.shape().divisor)};
  event_pending_ = true;
  return {};
}

// Changes a parameter of the law, also in flight. A refusal's value is the number of parameters.
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
  const Quantity lift_V = excess_lift_V(previous_output_.front_V, previous_output_.back_V,
                                        in.angle_rad[kElevation], limits.guard);
  recovery_.update(in, lift_V, previous_output_.front_V - previous_output_.back_V, limits.recovery);
  return recovery_.begins();
}

void UploadedLaw::hand_over(Takeover reason, float value) {
  tape_.fly(false);
  recovery_.start();
  event_ = {0, static_cast<std::uint8_t>(link::Event::law_taken_over),
            static_cast<std::uint8_t>(reason), 0, value};
  event_pending_ = true;
}

bool UploadedLaw::poll_event(link::EventMessage& event) {
  if (!event_pending_) {
    return false;
  }
  event_pending_ = false;
  event = event_;
  return true;
}

// If a law logs its own setpoint, a free signal logs the setpoint that the board gave it: without
// that, the flight could not be replayed from its log.
void UploadedLaw::assign_setpoint_signals() {
  std::uint32_t free_signal = tape_.shape().signals;
  for (std::uint32_t axis = 0; axis < kAxisCount; ++axis) {
    const auto setpoint_input = static_cast<std::uint32_t>(LawInput::elevation_setpoint_rad) + axis;
    const std::uint32_t reads = tape_.inputs_read() & (1U << setpoint_input | moving_inputs(axis));
    passes_board_setpoint_[axis] = tape_.passes_input(Shape::kFirstSetpoint + axis, setpoint_input);
    board_setpoint_signal_[axis] = link::kLawSignals;
    if (!passes_board_setpoint_[axis] && reads != 0U && free_signal < link::kLawSignals) {
      board_setpoint_signal_[axis] = free_signal++;
    }
  }
}

// Inputs are rounded as the log rounds them, so that a flight can be replayed bit for bit.
void UploadedLaw::read_inputs(const ControlInput& in, const Limits& limits) {
  const std::uint32_t read = tape_.inputs_read();
  const auto set_input = [this, read](LawInput first, std::size_t axis, Quantity value) {
    const std::size_t input = static_cast<std::size_t>(first) + axis;
    if ((read >> input & 1U) != 0U) {
      tape_.set_input(input, from_quantity(value));
    }
  };
  const bool call_begins = phase_ == 0U;
  for (std::size_t axis = 0; axis < kAxisCount; ++axis) {
    board_setpoint_raw_[axis] = product<0>(in.setpoint_rad[axis], kSetpointWire[axis]).raw();
    const Quantity setpoint_rad =
        product<24>(Whole::from_raw(board_setpoint_raw_[axis]), kSetpointUnit_rad[axis]);
    Quantity setpoint_rad_s;
    Quantity setpoint_rad_s2;
    if ((read & moving_inputs(static_cast<std::uint32_t>(axis))) != 0U) {
      setpoint_rad_s = setpoint_rate_[axis].update(setpoint_rad, limits.smoothing[axis]);
      setpoint_rad_s2 = setpoint_acceleration_[axis].update(setpoint_rad_s, limits.smoothing[axis]);
    }
    if (call_begins) {
      set_input(LawInput::elevation_rad, axis, in.angle_rad[axis]);
      set_input(LawInput::elevation_rad_s, axis, in.rate_rad_s[axis]);
      set_input(LawInput::elevation_setpoint_rad, axis, setpoint_rad);
      set_input(LawInput::elevation_setpoint_rad_s, axis, setpoint_rad_s);
      set_input(LawInput::elevation_setpoint_rad_s2, axis, setpoint_rad_s2);
    }
  }
  if (call_begins) {
    set_input(LawInput::front_V, 0, volts(applied_.front_raw));
    set_input(LawInput::back_V, 0, volts(applied_.back_raw));
  }
}

// At the end of a call: checks its outputs, then makes them the law's voltages, setpoints, signals
// and states.
GuardVerdict UploadedLaw::read_outputs(const Limits& limits) {
  const Shape& shape = tape_.shape();
  for (std::uint32_t index = 0; index < Shape::kFirstSignal + shape.signals; ++index) {
    if (!is_finite(tape_.output(index))) {
      return {Takeover::not_finite, static_cast<float>(index)};
    }
  }
  const auto volts_of = [this, &limits](std::size_t index) {
    return clamp(to_quantity(tape_.output(index)), limits.motor_min_V, limits.motor_max_V);
  };
  const LawOutput output{volts_of(0), volts_of(1),
                         to_quantity(tape_.output(Shape::kFirstSetpoint + kPitch))};
  if (has_output_) {
    const Quantity front_V = control::magnitude(output.front_V - output_.front_V);
    const Quantity back_V = control::magnitude(output.back_V - output_.back_V);
    const Quantity jump_V = front_V > back_V ? front_V : back_V;
    if (jump_V > limits.guard.jump_max_V) {
      return {Takeover::voltage_jump, jump_V.to_float()};
    }
  }
  first_output_ = !has_output_;
  has_output_ = true;
  output_ = output;
  for (std::size_t axis = 0; axis < kAxisCount; ++axis) {
    if (!passes_board_setpoint_[axis]) {
      const Quantity law_setpoint_rad = to_quantity(tape_.output(Shape::kFirstSetpoint + axis));
      setpoint_raw_[axis] = product<0>(law_setpoint_rad, kSetpointWire[axis]).raw();
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

// Limits the difference of the voltages first and each voltage then, as the cascade's mixer does.
void UploadedLaw::limit_voltages(ControlOutput& out, const Limits& limits) const {
  const Quantity front_V = out.front_V;
  const Quantity back_V = out.back_V;
  const Quantity mean_V = (front_V + back_V).half();
  const Quantity half_difference_V =
      clamp(front_V - back_V, -limits.differential_max_V, limits.differential_max_V).half();
  out.front_V = clamp(mean_V + half_difference_V, limits.motor_min_V, limits.motor_max_V);
  out.back_V = clamp(mean_V - half_difference_V, limits.motor_min_V, limits.motor_max_V);
  // Halving loses half a bit.
  constexpr Quantity kRounding_V = Quantity::from_raw(2);
  out.front_saturated = control::magnitude(out.front_V - front_V) > kRounding_V;
  out.back_saturated = control::magnitude(out.back_V - back_V) > kRounding_V;
}

bool UploadedLaw::update(const ControlInput& in, Bank bank, ControlOutput& out) {
  const Limits& limits = limits_[bank];
  read_inputs(in, limits);
  // A call of the law is spread over several ticks; its outputs change when it ends.
  GuardVerdict verdict{};
  first_output_ = false;
  if (phase_ < tape_.ticks() && tape_.run(phase_)) {
    verdict = read_outputs(limits);
  }
  // For the log. Before the first call has ended, and on axes whose setpoint the law passes on
  // unchanged, the setpoint is the one that the law is given.
  for (std::size_t axis = 0; axis < kAxisCount; ++axis) {
    if (!has_output_ || passes_board_setpoint_[axis]) {
      setpoint_raw_[axis] = board_setpoint_raw_[axis];
    }
    if (board_setpoint_signal_[axis] < link::kLawSignals) {
      signal_raw_[board_setpoint_signal_[axis]] = board_setpoint_raw_[axis];
    }
  }
  if (!has_output_) {
    output_.pitch_setpoint_rad = in.angle_rad[kPitch];
  }
  if (verdict.reason == Takeover::command) {
    verdict = guard_.check(in, output_, previous_output_, limits.guard);
  }
  if (verdict.reason != Takeover::command) {
    hand_over(verdict.reason, verdict.value);
    return false;
  }
  ++phase_;
  if (phase_ == tape_.shape().divisor) {
    phase_ = 0;
  }
  out = {};
  out.front_V = front_fade_.apply(output_.front_V, previous_output_.front_V, first_output_,
                                  limits.bumpless_keep);
  out.back_V = back_fade_.apply(output_.back_V, previous_output_.back_V, first_output_,
                                limits.bumpless_keep);
  // Until the first call has ended, the motors keep their voltages.
  if (!has_output_) {
    out.front_V = previous_output_.front_V;
    out.back_V = previous_output_.back_V;
  }
  limit_voltages(out, limits);
  previous_output_ = {out.front_V, out.back_V, output_.pitch_setpoint_rad};
  out.front_V = clamp(out.front_V + in.excitation_front_V, limits.motor_min_V, limits.motor_max_V);
  out.back_V = clamp(out.back_V + in.excitation_back_V, limits.motor_min_V, limits.motor_max_V);
  out.pitch_setpoint_rad = output_.pitch_setpoint_rad;
  return true;
}

}  // namespace heli::law
