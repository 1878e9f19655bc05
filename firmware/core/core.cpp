// One tick: encoders, commands, supervisor, control law, motors, log. Only start(), poll() and
// refresh_derived() run outside of the tick, in the idle loop; see core.hpp.
#include "core.hpp"

#include "control/math.hpp"

namespace heli {

using control::Bank;
using control::ControlInput;
using control::ControlOutput;
using control::Fixed;
using control::product;
using control::Quantity;
using control::Whole;
using link::Event;
using link::MessageId;
using link::Reply;
using link::Result;
using link::State;

namespace {

constexpr std::uint8_t kAllAxes = link::axes::elevation | link::axes::pitch | link::axes::travel;

// Steps of a channel on the wire per unit of the flight code.
using Wire = Fixed<14>;
constexpr Wire kElevationSetpointWire = Wire::of(link::kElevationSetpointPerUnit);
constexpr Wire kPitchSetpointWire = Wire::of(link::kPitchSetpointPerUnit);
constexpr Wire kTravelSetpointWire = Wire::of(link::kTravelSetpointPerUnit);
constexpr Wire kFrontWire = Wire::of(link::kFrontPerUnit);
constexpr Wire kBackWire = Wire::of(link::kBackPerUnit);

// Converts a value to the steps of its telemetry channel, as link.toml declares them.
std::int32_t to_wire(Quantity value, Wire per_unit) { return product<0>(value, per_unit).raw(); }

}  // namespace

Core::Core(Board& board, law::Simplex& laws, law::UploadedLaw& uploaded)
    : board_(board),
      laws_(laws),
      uploaded_(uploaded),
      store_(board),
      link_(board, params_, store_, uploaded.tape(), laws.names()),
      supervisor_(link_) {
  refresh_derived();
}

// A stored controller that this board does not have is replaced by the default.
void Core::start() {
  store_.load(params_);
  if (params_.get(link::Param::controller) >= static_cast<float>(laws_.names().count)) {
    store_.drop(params_, link::Param::controller);
  }
  refresh_derived();
  const BootReport report = board_.boot_report();
  link_.push_event({0, static_cast<std::uint8_t>(Event::boot), report.reset, report.boot_fault,
                    static_cast<float>(report.boot_id)});
}

// Idle loop: derives all constants from the parameters in the bank that no tick reads, then
// switches to that bank. A parameter that changes meanwhile causes another call.
void Core::refresh_derived() {
  const std::uint32_t revision = params_.revision();
  const auto unused_bank = static_cast<Bank>(1U - active_.load(std::memory_order_relaxed));
  derived_[unused_bank] = {conversion_of(params_, board_.duty_full()), flight::limits_of(params_),
                           flight::setpoint_limits_of(params_),
                           flight::tracking_limits_of(params_)};
  laws_.derive(control::IdleLoop(nullptr), params_, unused_bank);
  derived_revision_ = revision;
  active_.store(unused_bank, std::memory_order_release);
}

void Core::poll() {
  link_.poll();
  if (params_.revision() != derived_revision_) {
    refresh_derived();
  }
}

// Makes the present counts the zero of these axes (link::axes bits); elevation is then at its rest.
void Core::zero(const EncoderReading& reading, std::uint8_t axes) {
  for (std::size_t axis = 0; axis < kAxisCount; ++axis) {
    if ((axes & (1U << axis)) != 0U) {
      zero_count_[axis] = reading.count[axis];
      filters_[axis].restart();
    }
  }
  supervisor_.forget_steps(axes);
  link_.push_event({observation_.tick, static_cast<std::uint8_t>(Event::zeroed), axes, 0, 0.0F});
}

// Counts to angles and rates of this tick.
void Core::measure(const EncoderReading& reading, const Conversion& c,
                   const std::uint32_t (&step_max_counts)[kAxisCount]) {
  observation_.steps = 0;
  // One axis per tick, in turn: this spreads the work.
  const std::size_t turn = observation_.tick % flight::kTrackingSlots;
  if (turn < kAxisCount) {
    const std::uint32_t moved_counts = static_cast<std::uint32_t>(reading.count[turn]) -
                                       static_cast<std::uint32_t>(raw_count_[turn]);
    raw_count_[turn] = reading.count[turn];
    // Both directions in one comparison: a negative number is a large one without sign.
    if (moved_counts + step_max_counts[turn] > 2U * step_max_counts[turn]) {
      observation_.steps = static_cast<std::uint8_t>(1U << turn);
      observation_.step_counts = static_cast<std::int32_t>(moved_counts);
    }
  }
  for (std::size_t axis = 0; axis < kAxisCount; ++axis) {
    // Unsigned, because a free-running counter may wrap.
    const std::uint32_t counts_since_zero = static_cast<std::uint32_t>(reading.count[axis]) -
                                            static_cast<std::uint32_t>(zero_count_[axis]);
    const std::uint32_t zero =
        axis == kElevation ? static_cast<std::uint32_t>(c.elevation_rest_counts) : 0U;
    observation_.count[axis] = static_cast<std::int32_t>(
        (c.count_sign[axis] < 0 ? 0U - counts_since_zero : counts_since_zero) + zero);
  }
  for (std::size_t axis = 0; axis < kAxisCount; ++axis) {
    observation_.angle_rad[axis] =
        product<24>(Whole::from_raw(observation_.count[axis]), c.rad_per_count[axis]);
    observation_.rate_rad_s[axis] =
        filters_[axis].update(observation_.angle_rad[axis], c.smoothing[axis]);
    observation_.illegal[axis] = reading.illegal[axis];
    counters_.illegal[axis] = static_cast<std::uint16_t>(
        reading.illegal[axis] < 0xFFFFU ? reading.illegal[axis] : 0xFFFFU);
  }
}

// Executes one command of the host. Parameters, zero and uploaded laws are handled here, the rest
// by the supervisor.
Reply Core::execute(const link::Request& request, const EncoderReading& reading) {
  const bool idle = supervisor_.state() == State::idle;
  const Reply not_idle{Result::bad_state, static_cast<std::uint8_t>(supervisor_.state()), 0.0F};
  switch (request.id) {
    case MessageId::param_set:
      return set_parameter(request.as<link::ParamSetMessage>(), idle);
    case MessageId::params_default:
      if (!idle) {
        return not_idle;
      }
      params_.defaults();
      return {};
    // The idle loop saves after this reply: writing flash stops the processor.
    case MessageId::params_save:
      return idle ? Reply{} : not_idle;
    case MessageId::zero: {
      const auto message = request.as<link::ZeroMessage>();
      if (message.axes == 0U || (message.axes & ~kAllAxes) != 0U) {
        return {Result::bad_value, 1, static_cast<float>(message.axes)};
      }
      if (!idle) {
        return not_idle;
      }
      zero(reading, message.axes);
      return {};
    }
    case MessageId::law_fly:
      return fly_law(request.as<link::LawFlyMessage>().on != 0U);
    case MessageId::law_set:
      return uploaded_.set_parameter(request.as<link::LawSetMessage>());
    default:
      return supervisor_.execute(request);
  }
}

Reply Core::set_parameter(const link::ParamSetMessage& message, bool idle) {
  const auto which = static_cast<link::Param>(message.index);
  // The declaration does not contain the number of controllers that this board was built with.
  const bool no_such_controller =
      which == link::Param::controller && message.value >= static_cast<float>(laws_.names().count);
  const Result result =
      no_such_controller ? Result::out_of_range : params_.set(which, message.value, idle);
  return {result, message.index, result == Result::ok ? params_.get(which) : message.value};
}

// Hands the motors to the uploaded law or back. Only a flight with all loops closed may change
// over.
Reply Core::fly_law(bool on) {
  const auto state = static_cast<std::uint8_t>(supervisor_.state());
  if (!on) {
    if (uploaded_.flying()) {
      uploaded_.hand_over(link::Takeover::command, 0.0F);
    }
    return {Result::ok, state, 0.0F};
  }
  if (supervisor_.state() != State::closed_loop || supervisor_.axes() != kAllAxes) {
    return {Result::bad_law, static_cast<std::uint8_t>(link::LawError::not_flying),
            static_cast<float>(state)};
  }
  Reply reply = uploaded_.engage({to_wire(observation_.applied.front_V, kFrontWire),
                                  to_wire(observation_.applied.back_V, kBackWire)});
  if (reply.result == Result::ok) {
    reply.detail = state;
  }
  return reply;
}

// Runs the control law: motor volts of this tick, 0 while the motors are off or only armed.
ControlOutput Core::compute_output(Bank bank) {
  if (uploaded_.busy() && uploaded_.flying() &&
      (supervisor_.state() != State::closed_loop || supervisor_.axes() != kAllAxes)) {
    uploaded_.hand_over(link::Takeover::state, static_cast<float>(supervisor_.state()));
  }
  if (!supervisor_.motors_enabled() || supervisor_.state() == State::armed) {
    laws_.init(bank);
    ControlOutput off{};
    off.pitch_setpoint_rad = observation_.angle_rad[kPitch];
    return off;
  }
  // The excitation of this tick; its end by time is reported here.
  control::Exciter& exciter = supervisor_.exciter();
  const link::Excitation kind = exciter.kind();
  const control::ExcitationValue excitation = exciter.next();
  excited_ = exciter.running();
  if (kind != exciter.kind()) {
    link_.push_event({observation_.tick, static_cast<std::uint8_t>(Event::excitation_end),
                      static_cast<std::uint8_t>(kind), 0, 0.0F});
  }
  const flight::Setpoint elevation = supervisor_.setpoint(kElevation);
  const flight::Setpoint pitch = supervisor_.setpoint(kPitch);
  const flight::Setpoint travel = supervisor_.setpoint(kTravel);
  const bool travel_waits = supervisor_.travel_waits();
  // Built in one expression: clearing it first and filling it then takes 40 instructions more.
  const ControlInput in{
      {observation_.angle_rad[kElevation], observation_.angle_rad[kPitch],
       observation_.angle_rad[kTravel]},
      {observation_.rate_rad_s[kElevation], observation_.rate_rad_s[kPitch],
       observation_.rate_rad_s[kTravel]},
      {elevation.angle_rad, travel_waits ? supervisor_.waiting_pitch_rad() : pitch.angle_rad,
       travel.angle_rad},
      {elevation.rate_rad_s, pitch.rate_rad_s, travel.rate_rad_s},
      {elevation.acceleration_rad_s2, pitch.acceleration_rad_s2, travel.acceleration_rad_s2},
      supervisor_.axes(),
      supervisor_.open_voltages().front_V,
      supervisor_.open_voltages().back_V,
      excitation.front_V,
      excitation.back_V,
      travel_waits};
  ControlOutput out = laws_.update(in, bank);
  if (supervisor_.sinks_at_take_off()) {
    // The loop of elevation would add thrust until the wrong sign is certain.
    const Quantity hover_V = supervisor_.hover_motor_V();
    out.front_V = out.front_V < hover_V ? out.front_V : hover_V;
    out.back_V = out.back_V < hover_V ? out.back_V : hover_V;
  }
  return out;
}

// Writes the duties. The voltages that they give at the nominal supply are the applied ones.
void Core::write_motors(const ControlOutput& out, const Conversion& c) {
  const MotorCommand command =
      motor_command(supervisor_.motors_enabled(), out.front_V, out.back_V, c);
  board_.write_motors(command);
  observation_.applied = {product<24>(Whole::from_raw(command.front_duty), c.front.V_per_duty),
                          product<24>(Whole::from_raw(command.back_duty), c.back.V_per_duty)};
}

// Logs an uploaded law's setpoints, signals, start and end; log_tick() logs the rest.
void Core::log_law(link::Sample& sample) {
  using link::Channel;
  link::EventMessage event;
  if (uploaded_.poll_event(event)) {
    event.tick = observation_.tick;
    link_.push_event(event);
  }
  const auto set_channel = [&sample](Channel channel, std::int32_t value) {
    sample.raw[static_cast<std::size_t>(channel)] = value;
  };
  law::Recovery& recovery = uploaded_.recovery();
  // If the board's own law closes no axis, there is nothing to recover. A recovery must not prevent
  // a landing from descending.
  if (supervisor_.axes() == 0U ||
      (recovery.returning() && supervisor_.state() != State::closed_loop)) {
    recovery.stop();
  }
  uploaded_.update_busy();
  // While the arm swings, elevation may rest for half a second at the top of its swing.
  if (recovery.active() && !recovery.returning()) {
    supervisor_.restart_tracking();
  }
  // The supervisor's setpoints continue from those of the recovery, which are logged.
  const auto report_recovery = [this, &recovery, &set_channel](std::size_t axis, Channel channel,
                                                               Wire per_unit) {
    if (recovery.active() && recovery.overrides(axis)) {
      supervisor_.continue_from(axis, recovery.setpoint_rad(axis));
      set_channel(channel, to_wire(recovery.setpoint_rad(axis), per_unit));
    }
  };
  report_recovery(kElevation, Channel::elevation_setpoint, kElevationSetpointWire);
  report_recovery(kTravel, Channel::travel_setpoint, kTravelSetpointWire);
  if (!uploaded_.flying()) {
    return;
  }
  sample.raw[static_cast<std::size_t>(Channel::flags)] |= link::flags::law;
  set_channel(Channel::elevation_setpoint, uploaded_.setpoint_raw(kElevation));
  set_channel(Channel::pitch_setpoint, uploaded_.setpoint_raw(kPitch));
  set_channel(Channel::travel_setpoint, uploaded_.setpoint_raw(kTravel));
  set_channel(Channel::signal_1, uploaded_.signal_raw(0));
  set_channel(Channel::signal_2, uploaded_.signal_raw(1));
  set_channel(Channel::signal_3, uploaded_.signal_raw(2));
  set_channel(Channel::signal_4, uploaded_.signal_raw(3));
  uploaded_.set_applied({sample.raw[static_cast<std::size_t>(Channel::front)],
                         sample.raw[static_cast<std::size_t>(Channel::back)]});
}

// Fills and commits the sample of this tick, then publishes the counters for the idle loop.
void Core::log_tick(const ControlOutput& out, TickTiming timing) {
  link::Sample& sample = link_.next_sample();
  sample.tick = observation_.tick;
  using link::Channel;
  // A host that streams voltages may send the setpoints that its law follows.
  const bool streamed = supervisor_.host_setpoints_known();
  const auto setpoint = [this, streamed](std::size_t axis, Quantity board_rad) {
    return streamed ? supervisor_.host_setpoint_rad(axis) : board_rad;
  };
  std::uint8_t flags = 0;
  const auto set_flag = [&flags](bool condition, std::uint8_t bit) {
    flags = static_cast<std::uint8_t>(flags | (condition ? bit : 0U));
  };
  set_flag(out.front_saturated, link::flags::front_saturated);
  set_flag(out.back_saturated, link::flags::back_saturated);
  set_flag(excited_, link::flags::excitation);
  set_flag(supervisor_.link_alive(), link::flags::link_alive);
  set_flag(out.pitch_limited, link::flags::pitch_limited);
  set_flag(timing.late, link::flags::overrun);
  link::SampleWriter(sample)
      .put<Channel::elevation_count>(observation_.count[kElevation])
      .put<Channel::pitch_count>(observation_.count[kPitch])
      .put<Channel::travel_count>(observation_.count[kTravel])
      .put<Channel::elevation_setpoint>(to_wire(
          setpoint(kElevation, supervisor_.setpoint_rad(kElevation)), kElevationSetpointWire))
      .put<Channel::pitch_setpoint>(
          to_wire(setpoint(kPitch, out.pitch_setpoint_rad), kPitchSetpointWire))
      .put<Channel::travel_setpoint>(
          to_wire(setpoint(kTravel, supervisor_.setpoint_rad(kTravel)), kTravelSetpointWire))
      .put<Channel::front>(to_wire(observation_.applied.front_V, kFrontWire))
      .put<Channel::back>(to_wire(observation_.applied.back_V, kBackWire))
      .put<Channel::state>(static_cast<std::int32_t>(supervisor_.state()))
      .put<Channel::fault>(static_cast<std::int32_t>(supervisor_.fault()))
      .put<Channel::trigger>(static_cast<std::int32_t>(supervisor_.cause()))
      .put<Channel::signal_1>(0)
      .put<Channel::signal_2>(0)
      .put<Channel::signal_3>(0)
      .put<Channel::signal_4>(0)
      .put<Channel::flags>(flags)
      .done();
  if (uploaded_.busy()) {
    log_law(sample);
  }
  link_.commit_sample(sample);

  counters_.overruns += timing.late ? 1U : 0U;
  counters_.tick_max_us =
      timing.last_us > counters_.tick_max_us ? timing.last_us : counters_.tick_max_us;
  counters_.stale_streams = supervisor_.refused_streams();
  counters_.setpoint_rate_Hz = supervisor_.setpoint_rate_Hz();
  link_.publish(counters_);
}

void Core::tick(TickTiming timing) {
  link_.begin_tick(observation_.tick);
  const EncoderReading reading = board_.read_encoders();
  if (!zeroed_) {
    zeroed_ = true;
    zero(reading, kAllAxes);
    for (std::size_t axis = 0; axis < kAxisCount; ++axis) {
      raw_count_[axis] = reading.count[axis];
    }
  }
  const Bank bank = active_.load(std::memory_order_acquire);
  const Derived& derived = derived_[bank];
  measure(reading, derived.conversion, derived.limits.step_max_counts);

  // Motor voltages and pitch setpoint are those of the previous tick.
  observation_.overload_edges = reading.overload_edges;
  observation_.overruns = counters_.overruns;
  observation_.hardware_stop = board_.hardware_stop();
  observation_.link_age_ticks = link_.ticks_since_host_frame();
  observation_.params_usable = store_.source() != link::ParamsSource::corrupt;
  observation_.law_busy = uploaded_.busy();
  supervisor_.observe(observation_, derived.limits, derived.setpoint_limits, derived.tracking);

  // Commands and streams of the host, then the checks, then the control law.
  if (const link::Request* request = link_.take_request()) {
    link_.answer(execute(*request, reading));
  }
  link::StreamValue value;
  while (link_.take_stream(value)) {
    supervisor_.take_stream(value);
  }
  supervisor_.advance();
  excited_ = false;
  const ControlOutput out = compute_output(bank);
  write_motors(out, derived.conversion);
  observation_.pitch_setpoint_rad = out.pitch_setpoint_rad;
  log_tick(out, timing);
  ++observation_.tick;
}

}  // namespace heli
