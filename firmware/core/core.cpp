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

std::int16_t duty_of(Quantity voltage_V, const MotorConversion& motor) {
  const std::int32_t duty = product<0>(voltage_V, motor.duty_per_V).raw();
  return static_cast<std::int16_t>(control::clamp(duty, motor.least_duty, motor.most_duty));
}

// Units on the wire per unit.
using Wire = Fixed<14>;
constexpr Wire kElevationSetpointWire = Wire::of(link::kElevationSetpointPerUnit);
constexpr Wire kPitchSetpointWire = Wire::of(link::kPitchSetpointPerUnit);
constexpr Wire kTravelSetpointWire = Wire::of(link::kTravelSetpointPerUnit);
constexpr Wire kFrontWire = Wire::of(link::kFrontPerUnit);
constexpr Wire kBackWire = Wire::of(link::kBackPerUnit);

std::int32_t wire(Quantity value, Wire per_unit) { return product<0>(value, per_unit).raw(); }

}  // namespace

Core::Core(Board& board, control::Controller& law)
    : board_(board), law_(law), store_(board), link_(board, params_, store_), supervisor_(link_) {
  refresh_derived();
}

void Core::start() {
  store_.load(params_);
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
  law_.derive(params_, spare);
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
  link_.push_event({tick_, static_cast<std::uint8_t>(Event::zeroed), axes, 0, 0.0F});
}

void Core::measure(const EncoderReading& reading, const Conversion& c) {
  for (std::size_t axis = 0; axis < kAxisCount; ++axis) {
    // Unsigned, because a free-running counter may wrap.
    const std::uint32_t turned = static_cast<std::uint32_t>(reading.count[axis]) -
                                 static_cast<std::uint32_t>(zero_count_[axis]);
    const std::uint32_t zero =
        axis == kElevation ? static_cast<std::uint32_t>(c.elevation_rest_counts) : 0U;
    count_[axis] =
        static_cast<std::int32_t>((c.count_sign[axis] < 0 ? 0U - turned : turned) + zero);
  }
  for (std::size_t axis = 0; axis < kAxisCount; ++axis) {
    angle_rad_[axis] = product<24>(Whole::from_raw(count_[axis]), c.rad_per_count[axis]);
    rate_rad_s_[axis] = filters_[axis].update(angle_rad_[axis], c.smoothing[axis]);
    counters_.illegal[axis] = static_cast<std::uint16_t>(
        reading.illegal[axis] < 0xFFFFU ? reading.illegal[axis] : 0xFFFFU);
  }
}

Reply Core::execute(const link::Request& request, const EncoderReading& reading) {
  const bool idle = supervisor_.state() == State::idle;
  const Reply not_idle{Result::bad_state, static_cast<std::uint8_t>(supervisor_.state()), 0.0F};
  switch (request.id) {
    case MessageId::param_set: {
      const auto message = request.as<link::ParamSetMessage>();
      const auto which = static_cast<link::Param>(message.index);
      const Result result = params_.set(which, message.value, idle);
      return {result, message.index, result == Result::ok ? params_.get(which) : message.value};
    }
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
    default:
      return supervisor_.execute(request);
  }
}

ControlOutput Core::drive(Bank bank) {
  if (!supervisor_.motors_enabled() || supervisor_.state() == State::armed) {
    law_.reset();
    ControlOutput off{};
    off.pitch_setpoint_rad = angle_rad_[kPitch];
    return off;
  }
  control::Exciter& exciter = supervisor_.exciter();
  const link::Excitation kind = exciter.kind();
  const control::ExcitationValue excitation = exciter.next();
  excited_ = exciter.running();
  if (kind != exciter.kind()) {
    link_.push_event({tick_, static_cast<std::uint8_t>(Event::excitation_end),
                      static_cast<std::uint8_t>(kind), 0, 0.0F});
  }
  ControlInput in{};
  for (std::size_t axis = 0; axis < kAxisCount; ++axis) {
    in.angle_rad[axis] = angle_rad_[axis];
    in.rate_rad_s[axis] = rate_rad_s_[axis];
    const flight::Setpoint setpoint = supervisor_.setpoint(axis);
    in.setpoint_rad[axis] = setpoint.angle_rad;
    in.setpoint_rate_rad_s[axis] = setpoint.rate_rad_s;
    in.setpoint_acceleration_rad_s2[axis] = setpoint.acceleration_rad_s2;
  }
  in.axes = supervisor_.axes();
  in.open_front_V = supervisor_.open_voltages().front_V;
  in.open_back_V = supervisor_.open_voltages().back_V;
  in.excitation_front_V = excitation.front_V;
  in.excitation_back_V = excitation.back_V;
  return law_.update(in, bank);
}

void Core::actuate(const ControlOutput& out, const Conversion& c) {
  MotorCommand command{};
  command.enable = supervisor_.motors_enabled();
  if (command.enable) {
    command.front_duty = duty_of(out.front_V, c.front);
    command.back_duty = duty_of(out.back_V, c.back);
  }
  board_.write_motors(command);
  acted_ = {product<24>(Whole::from_raw(command.front_duty), c.front.V_per_duty),
            product<24>(Whole::from_raw(command.back_duty), c.back.V_per_duty)};
}

void Core::log_tick(const ControlOutput& out, TickTiming timing) {
  link::Sample sample;
  sample.tick = tick_;
  const auto put = [&sample](link::Channel channel, std::int32_t value) {
    sample.raw[static_cast<std::size_t>(channel)] = value;
  };
  using link::Channel;
  put(Channel::elevation_count, count_[kElevation]);
  put(Channel::pitch_count, count_[kPitch]);
  put(Channel::travel_count, count_[kTravel]);
  put(Channel::elevation_setpoint,
      wire(supervisor_.setpoint_rad(kElevation), kElevationSetpointWire));
  put(Channel::pitch_setpoint, wire(out.pitch_setpoint_rad, kPitchSetpointWire));
  put(Channel::travel_setpoint, wire(supervisor_.setpoint_rad(kTravel), kTravelSetpointWire));
  put(Channel::front, wire(acted_.front_V, kFrontWire));
  put(Channel::back, wire(acted_.back_V, kBackWire));
  put(Channel::state, static_cast<std::int32_t>(supervisor_.state()));
  put(Channel::fault, static_cast<std::int32_t>(supervisor_.fault()));
  put(Channel::trigger, static_cast<std::int32_t>(supervisor_.cause()));
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
  put(Channel::flags, flags);
  link_.push_sample(sample);

  counters_.overruns += timing.late ? 1U : 0U;
  counters_.tick_max_us =
      timing.last_us > counters_.tick_max_us ? timing.last_us : counters_.tick_max_us;
  counters_.stale_streams = supervisor_.refused_streams();
  counters_.setpoint_rate_Hz = supervisor_.setpoint_rate_Hz();
  link_.publish(counters_);
}

void Core::tick(TickTiming timing) {
  link_.begin_tick(tick_);
  const EncoderReading reading = board_.read_encoders();
  if (!zeroed_) {
    zeroed_ = true;
    zero(reading, kAllAxes);
  }
  const Bank bank = active_.load(std::memory_order_acquire);
  const Derived& derived = derived_[bank];
  measure(reading, derived.conversion);

  flight::Observation seen{};
  seen.tick = tick_;
  for (std::size_t axis = 0; axis < kAxisCount; ++axis) {
    seen.angle_rad[axis] = angle_rad_[axis];
    seen.rate_rad_s[axis] = rate_rad_s_[axis];
    seen.count[axis] = count_[axis];
    seen.illegal[axis] = reading.illegal[axis];
  }
  seen.overload_edges = reading.overload_edges;
  seen.overruns = counters_.overruns;
  seen.hardware_stop = board_.hardware_stop();
  seen.link_age_ticks = link_.ticks_since_host_frame();
  seen.acted = acted_;
  seen.pitch_setpoint_rad = pitch_setpoint_rad_;
  seen.params_usable = store_.source() != link::ParamsSource::corrupt;
  supervisor_.observe(seen, derived.limits, derived.bounds, derived.tracking);

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
  pitch_setpoint_rad_ = out.pitch_setpoint_rad;
  log_tick(out, timing);
  ++tick_;
}

}  // namespace heli
