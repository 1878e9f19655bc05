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

std::int32_t wire(Quantity value, Wire per_unit) { return product<0>(value, per_unit).raw(); }

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

void Core::refresh_derived() {
  const std::uint32_t revision = params_.revision();
  const auto spare = static_cast<Bank>(1U - active_.load(std::memory_order_relaxed));
  derived_[spare] = {conversion_of(params_, board_.duty_full()), flight::limits_of(params_),
                     flight::setpoint_limits_of(params_), flight::tracking_limits_of(params_)};
  laws_.derive(control::IdleLoop(nullptr), params_, spare);
  derived_revision_ = revision;
  active_.store(spare, std::memory_order_release);
}

void Core::poll() {
  link_.poll();
  if (params_.revision() != derived_revision_) {
    refresh_derived();
  }
}

void Core::zero(const EncoderReading& reading, std::uint8_t axes) {
  for (std::size_t axis = 0; axis < kAxisCount; ++axis) {
    if ((axes & (1U << axis)) != 0U) {
      zero_count_[axis] = reading.count[axis];
      filters_[axis].restart();
    }
  }
  link_.push_event({seen_.tick, static_cast<std::uint8_t>(Event::zeroed), axes, 0, 0.0F});
}

void Core::measure(const EncoderReading& reading, const Conversion& c) {
  for (std::size_t axis = 0; axis < kAxisCount; ++axis) {
    // Unsigned, because a free-running counter may wrap.
    const std::uint32_t turned = static_cast<std::uint32_t>(reading.count[axis]) -
                                 static_cast<std::uint32_t>(zero_count_[axis]);
    const std::uint32_t zero =
        axis == kElevation ? static_cast<std::uint32_t>(c.elevation_rest_counts) : 0U;
    seen_.count[axis] =
        static_cast<std::int32_t>((c.count_sign[axis] < 0 ? 0U - turned : turned) + zero);
  }
  for (std::size_t axis = 0; axis < kAxisCount; ++axis) {
    seen_.angle_rad[axis] = product<24>(Whole::from_raw(seen_.count[axis]), c.rad_per_count[axis]);
    seen_.rate_rad_s[axis] = filters_[axis].update(seen_.angle_rad[axis], c.smoothing[axis]);
    seen_.illegal[axis] = reading.illegal[axis];
    counters_.illegal[axis] = static_cast<std::uint16_t>(
        reading.illegal[axis] < 0xFFFFU ? reading.illegal[axis] : 0xFFFFU);
  }
}

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
  const bool no_such_row =
      which == link::Param::controller && message.value >= static_cast<float>(laws_.names().count);
  const Result result =
      no_such_row ? Result::out_of_range : params_.set(which, message.value, idle);
  return {result, message.index, result == Result::ok ? params_.get(which) : message.value};
}

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
  Reply reply = uploaded_.engage(
      {wire(seen_.acted.front_V, kFrontWire), wire(seen_.acted.back_V, kBackWire)});
  if (reply.result == Result::ok) {
    reply.detail = state;
  }
  return reply;
}

ControlOutput Core::drive(Bank bank) {
  if (uploaded_.busy() && uploaded_.flying() &&
      (supervisor_.state() != State::closed_loop || supervisor_.axes() != kAllAxes)) {
    uploaded_.hand_over(link::Takeover::state, static_cast<float>(supervisor_.state()));
  }
  if (!supervisor_.motors_enabled() || supervisor_.state() == State::armed) {
    laws_.init(bank);
    ControlOutput off{};
    off.pitch_setpoint_rad = seen_.angle_rad[kPitch];
    return off;
  }
  control::Exciter& exciter = supervisor_.exciter();
  const link::Excitation kind = exciter.kind();
  const control::ExcitationValue excitation = exciter.next();
  excited_ = exciter.running();
  if (kind != exciter.kind()) {
    link_.push_event({seen_.tick, static_cast<std::uint8_t>(Event::excitation_end),
                      static_cast<std::uint8_t>(kind), 0, 0.0F});
  }
  const flight::Setpoint elevation = supervisor_.setpoint(kElevation);
  const flight::Setpoint pitch = supervisor_.setpoint(kPitch);
  const flight::Setpoint travel = supervisor_.setpoint(kTravel);
  const bool waits = supervisor_.travel_waits();
  // Built in one expression: clearing it first and filling it then takes 40 instructions more.
  const ControlInput in{
      {seen_.angle_rad[kElevation], seen_.angle_rad[kPitch], seen_.angle_rad[kTravel]},
      {seen_.rate_rad_s[kElevation], seen_.rate_rad_s[kPitch], seen_.rate_rad_s[kTravel]},
      {elevation.angle_rad, waits ? supervisor_.waiting_pitch_rad() : pitch.angle_rad,
       travel.angle_rad},
      {elevation.rate_rad_s, pitch.rate_rad_s, travel.rate_rad_s},
      {elevation.acceleration_rad_s2, pitch.acceleration_rad_s2, travel.acceleration_rad_s2},
      supervisor_.axes(),
      supervisor_.open_voltages().front_V,
      supervisor_.open_voltages().back_V,
      excitation.front_V,
      excitation.back_V,
      waits};
  return laws_.update(in, bank);
}

void Core::actuate(const ControlOutput& out, const Conversion& c) {
  const MotorCommand command =
      motor_command(supervisor_.motors_enabled(), out.front_V, out.back_V, c);
  board_.write_motors(command);
  seen_.acted = {product<24>(Whole::from_raw(command.front_duty), c.front.V_per_duty),
                 product<24>(Whole::from_raw(command.back_duty), c.back.V_per_duty)};
}

// Logs an uploaded law's setpoints, signals, start and end; log_tick() logs the rest.
void Core::log_law(link::Sample& sample) {
  using link::Channel;
  link::EventMessage event;
  if (uploaded_.poll_event(event)) {
    event.tick = seen_.tick;
    link_.push_event(event);
  }
  const auto overwrite = [&sample](Channel channel, std::int32_t value) {
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
  const auto move = [this, &recovery, &overwrite](std::size_t axis, Channel channel,
                                                  Wire per_unit) {
    if (recovery.active() && recovery.overrides(axis)) {
      supervisor_.continue_from(axis, recovery.setpoint_rad(axis));
      overwrite(channel, wire(recovery.setpoint_rad(axis), per_unit));
    }
  };
  move(kElevation, Channel::elevation_setpoint, kElevationSetpointWire);
  move(kTravel, Channel::travel_setpoint, kTravelSetpointWire);
  if (!uploaded_.flying()) {
    return;
  }
  sample.raw[static_cast<std::size_t>(Channel::flags)] |= link::flags::law;
  overwrite(Channel::elevation_setpoint, uploaded_.setpoint_raw(kElevation));
  overwrite(Channel::pitch_setpoint, uploaded_.setpoint_raw(kPitch));
  overwrite(Channel::travel_setpoint, uploaded_.setpoint_raw(kTravel));
  overwrite(Channel::signal_1, uploaded_.signal_raw(0));
  overwrite(Channel::signal_2, uploaded_.signal_raw(1));
  overwrite(Channel::signal_3, uploaded_.signal_raw(2));
  overwrite(Channel::signal_4, uploaded_.signal_raw(3));
  uploaded_.set_acted({sample.raw[static_cast<std::size_t>(Channel::front)],
                       sample.raw[static_cast<std::size_t>(Channel::back)]});
}

void Core::log_tick(const ControlOutput& out, TickTiming timing) {
  link::Sample& sample = link_.next_sample();
  sample.tick = seen_.tick;
  using link::Channel;
  // A host that streams voltages may send the setpoints that its law follows.
  const bool streamed = supervisor_.follows();
  const auto setpoint = [this, streamed](std::size_t axis, Quantity board_rad) {
    return streamed ? supervisor_.following_rad(axis) : board_rad;
  };
  std::uint8_t flags = 0;
  const auto raise = [&flags](bool condition, std::uint8_t bit) {
    flags = static_cast<std::uint8_t>(flags | (condition ? bit : 0U));
  };
  raise(out.front_saturated, link::flags::front_saturated);
  raise(out.back_saturated, link::flags::back_saturated);
  raise(excited_, link::flags::excitation);
  raise(supervisor_.link_alive(), link::flags::link_alive);
  raise(out.pitch_limited, link::flags::pitch_limited);
  raise(timing.late, link::flags::overrun);
  link::SampleWriter(sample)
      .put<Channel::elevation_count>(seen_.count[kElevation])
      .put<Channel::pitch_count>(seen_.count[kPitch])
      .put<Channel::travel_count>(seen_.count[kTravel])
      .put<Channel::elevation_setpoint>(
          wire(setpoint(kElevation, supervisor_.setpoint_rad(kElevation)), kElevationSetpointWire))
      .put<Channel::pitch_setpoint>(
          wire(setpoint(kPitch, out.pitch_setpoint_rad), kPitchSetpointWire))
      .put<Channel::travel_setpoint>(
          wire(setpoint(kTravel, supervisor_.setpoint_rad(kTravel)), kTravelSetpointWire))
      .put<Channel::front>(wire(seen_.acted.front_V, kFrontWire))
      .put<Channel::back>(wire(seen_.acted.back_V, kBackWire))
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
  link_.begin_tick(seen_.tick);
  const EncoderReading reading = board_.read_encoders();
  if (!zeroed_) {
    zeroed_ = true;
    zero(reading, kAllAxes);
  }
  const Bank bank = active_.load(std::memory_order_acquire);
  const Derived& derived = derived_[bank];
  measure(reading, derived.conversion);

  // Motor voltages and pitch setpoint are those of the previous tick.
  seen_.overload_edges = reading.overload_edges;
  seen_.overruns = counters_.overruns;
  seen_.hardware_stop = board_.hardware_stop();
  seen_.link_age_ticks = link_.ticks_since_host_frame();
  seen_.params_usable = store_.source() != link::ParamsSource::corrupt;
  seen_.law_busy = uploaded_.busy();
  supervisor_.observe(seen_, derived.limits, derived.bounds, derived.tracking);

  if (const link::Request* request = link_.take_request()) {
    link_.answer(execute(*request, reading));
  }
  link::StreamValue value;
  while (link_.take_stream(value)) {
    supervisor_.take_stream(value);
  }
  supervisor_.advance();
  excited_ = false;
  const ControlOutput out = drive(bank);
  actuate(out, derived.conversion);
  seen_.pitch_setpoint_rad = out.pitch_setpoint_rad;
  log_tick(out, timing);
  ++seen_.tick;
}

}  // namespace heli
