// Laws that come over the link, on this machine: the flight code's own arithmetic, tape and flight.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/array.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include <array>
#include <cstdint>
#include <cstring>
#include <memory>
#include <optional>
#include <stdexcept>
#include <tuple>
#include <vector>

#include "control/loop.hpp"
#include "conversion.hpp"
#include "law/functions.hpp"
#include "law/tape.hpp"
#include "law/uploaded_law.hpp"
#include "link/crc32.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace {

using heli::law::Bits;
using heli::law::Tape;
using heli::law::UploadCheck;
using heli::link::LawError;
using Words = std::vector<std::uint32_t>;
using Floats = nb::ndarray<const float, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
using Result = nb::ndarray<nb::numpy, float, nb::ndim<2>>;

float float_of(Bits bits) {
  float value = 0.0F;
  std::memcpy(&value, &bits, sizeof value);
  return value;
}

// As the link brings it, part by part.
UploadCheck upload(Tape& tape, const Words& words, std::uint32_t hash) {
  heli::link::LawBeginMessage begin;
  begin.hash = hash;
  begin.words = static_cast<std::uint16_t>(words.size());
  UploadCheck check = tape.begin(begin);
  if (check.error != LawError::none || words.size() > 0xffffU) return check;
  constexpr std::size_t kPart = 12;
  for (std::size_t first = 0; first < words.size(); first += kPart) {
    std::uint8_t payload[heli::link::LawPartMessage::kSize] = {};
    heli::link::put_u16(payload + 1, static_cast<std::uint16_t>(first));
    for (std::size_t k = 0; k < kPart && first + k < words.size(); ++k) {
      heli::link::put_u32(payload + 3 + 4 * k, words[first + k]);
    }
    check = tape.receive(heli::link::LawPartMessage::read(payload));
    if (check.error != LawError::none) return check;
  }
  return tape.end();
}

// A tape that runs by itself: cells in, outputs out.
class LoadedTape {
 public:
  LoadedTape() : tape_(std::make_unique<Tape>()) {}

  std::tuple<int, std::uint32_t, std::uint32_t> load(const Words& words, std::uint32_t hash) {
    const UploadCheck check = upload(*tape_, words, hash);
    return {static_cast<int>(check.error), check.value, tape_->ticks()};
  }

  void restart() {
    check_ready();
    tape_->restart();
  }

  bool set_parameter(std::uint32_t index, float value) {
    check_ready();
    return tape_->set_parameter(index, heli::law::bits_of(value));
  }

  // One call for each row of inputs; rows of outputs: voltages, setpoints, signals.
  Result run(const Floats& inputs) {
    check_ready();
    if (inputs.shape(1) != heli::link::kLawInputCount) {
      throw std::invalid_argument("a row has as many numbers as a law has inputs");
    }
    const std::size_t rows = inputs.shape(0);
    const std::size_t columns = heli::law::Shape::kFirstSignal + tape_->shape().signals;
    auto* out = new float[rows * columns + 1];
    const nb::capsule owner(out, [](void* p) noexcept { delete[] static_cast<float*>(p); });
    for (std::size_t row = 0; row < rows; ++row) {
      for (std::size_t k = 0; k < heli::link::kLawInputCount; ++k) {
        const Bits bits = heli::law::bits_of(inputs.data()[row * inputs.shape(1) + k]);
        tape_->set_input(k, heli::law::flushed(bits));
      }
      std::uint32_t tick = 0;
      while (!tape_->run(tick)) ++tick;
      for (std::size_t k = 0; k < columns; ++k) {
        out[row * columns + k] = float_of(tape_->output(k));
      }
      tape_->commit_states();
    }
    return {out, {rows, columns}, owner};
  }

 private:
  void check_ready() const {
    if (tape_->state() != heli::link::LawState::ready) {
      throw std::invalid_argument("no law is loaded");
    }
  }

  std::unique_ptr<Tape> tape_;
};

// The whole of what a board does with a law in flight, fed from a log.
class LawReplay {
 public:
  LawReplay(const std::vector<float>& params, std::int16_t duty_full)
      : uploaded_(std::make_unique<heli::law::UploadedLaw>()) {
    if (params.size() != heli::link::kParamCount) throw std::invalid_argument("not the parameters");
    for (std::size_t i = 0; i < params.size(); ++i) {
      params_.set(static_cast<heli::link::Param>(i), params[i], true);
    }
    uploaded_->derive(params_, 0);
    conversion_ = heli::conversion_of(params_, duty_full);
  }

  int load(const Words& words, std::uint32_t hash) {
    return static_cast<int>(upload(uploaded_->tape(), words, hash).error);
  }

  // Angles from counts, as every tick does; also of the ticks before the law flew.
  void measure(const std::array<std::int32_t, heli::kAxisCount>& counts) {
    for (std::size_t axis = 0; axis < heli::kAxisCount; ++axis) {
      in_.angle_rad[axis] = heli::control::product<24>(heli::control::Whole::from_raw(counts[axis]),
                                                       conversion_.rad_per_count[axis]);
      in_.rate_rad_s[axis] =
          filters_[axis].update(in_.angle_rad[axis], conversion_.smoothing[axis]);
    }
  }

  bool engage(std::int32_t front_raw, std::int32_t back_raw) {
    return uploaded_->engage({front_raw, back_raw}).result == heli::link::Result::ok;
  }

  bool set_parameter(std::uint8_t index, float value) {
    heli::link::LawSetMessage message;
    message.index = index;
    message.value = value;
    return uploaded_->set_parameter(message).result == heli::link::Result::ok;
  }

  // Reason and value of the last beginning or end that was not asked for yet.
  std::tuple<int, float> news() {
    heli::link::EventMessage event;
    if (!uploaded_->poll_event(event)) throw std::invalid_argument("there is no news");
    return {event.detail, event.value};
  }

  // Raw front and back voltage of the log; none when the law was taken over.
  std::optional<std::tuple<std::int32_t, std::int32_t>> update(
      const std::array<std::int32_t, heli::kAxisCount>& setpoint_raw) {
    constexpr float kPerUnit[] = {heli::link::kElevationSetpointPerUnit,
                                  heli::link::kPitchSetpointPerUnit,
                                  heli::link::kTravelSetpointPerUnit};
    for (std::size_t axis = 0; axis < heli::kAxisCount; ++axis) {
      in_.setpoint_rad[axis] =
          heli::control::Quantity::of(static_cast<float>(setpoint_raw[axis]) / kPerUnit[axis]);
    }
    heli::control::ControlOutput out{};
    if (!uploaded_->update(in_, 0, out)) return std::nullopt;
    const auto raw = [](heli::control::Quantity volts_V, const heli::MotorConversion& motor,
                        float per_V) {
      const auto whole = heli::control::product<0>(volts_V, motor.duty_per_V).raw();
      const auto duty = heli::control::clamp<std::int32_t>(whole, motor.min_duty, motor.max_duty);
      const auto applied =
          heli::control::product<24>(heli::control::Whole::from_raw(duty), motor.V_per_duty);
      return heli::control::product<0>(applied, heli::control::Fixed<14>::of(per_V)).raw();
    };
    const heli::law::AppliedVoltages applied{
        raw(out.front_V, conversion_.front, heli::link::kFrontPerUnit),
        raw(out.back_V, conversion_.back, heli::link::kBackPerUnit)};
    uploaded_->set_applied(applied);
    return std::tuple(applied.front_raw, applied.back_raw);
  }

  std::tuple<std::array<std::int32_t, heli::kAxisCount>, std::array<std::int32_t, 4>> outputs()
      const {
    return {{uploaded_->setpoint_raw(0), uploaded_->setpoint_raw(1), uploaded_->setpoint_raw(2)},
            {uploaded_->signal_raw(0), uploaded_->signal_raw(1), uploaded_->signal_raw(2),
             uploaded_->signal_raw(3)}};
  }

 private:
  heli::params::Params params_;
  heli::Conversion conversion_;
  heli::control::RateFilter filters_[heli::kAxisCount];
  heli::control::ControlInput in_{};
  std::unique_ptr<heli::law::UploadedLaw> uploaded_;
};

// An operation of two operands on arrays, one of them unused where it has one.
Result operate(std::uint32_t code, const Floats& operands) {
  Tape tape;
  const std::uint32_t written = heli::link::kLawInputCount;
  const std::uint32_t binary = heli::link::kBinaryOperations >> code & 1U;
  Words words = {heli::link::kLawFormat | 1U << 8U, 0U, 1U};
  for (std::size_t k = 0; k < heli::law::Shape::kFirstSignal; ++k) words.push_back(written);
  words.push_back(code << 27U | written << 18U | 0U << 9U | binary);
  std::uint32_t crc = 0;
  for (const std::uint32_t word : words) {
    std::uint8_t bytes[4];
    heli::link::put_u32(bytes, word);
    crc = heli::link::crc32(bytes, sizeof bytes, crc);
  }
  if (upload(tape, words, crc).error != LawError::none || operands.shape(1) != 2) {
    throw std::invalid_argument("no such operation, or not two operands a row");
  }
  const std::size_t rows = operands.shape(0);
  auto* out = new float[rows + 1];
  const nb::capsule owner(out, [](void* p) noexcept { delete[] static_cast<float*>(p); });
  for (std::size_t row = 0; row < rows; ++row) {
    for (std::size_t k = 0; k < 2; ++k) {
      tape.set_input(k, heli::law::flushed(heli::law::bits_of(operands.data()[2 * row + k])));
    }
    tape.run(0);
    out[row] = float_of(tape.output(0));
  }
  return {out, {rows, 1}, owner};
}

}  // namespace

void bind_law(nb::module_& parent) {
  nb::module_ module =
      parent.def_submodule("law", "A law's arithmetic, its tape, and flights replayed.");
  nb::class_<LoadedTape>(module, "Tape")
      .def(nb::init<>())
      .def("load", &LoadedTape::load, "words"_a, "hash"_a)
      .def("restart", &LoadedTape::restart)
      .def("set_parameter", &LoadedTape::set_parameter, "index"_a, "value"_a)
      .def("run", &LoadedTape::run, "inputs"_a);
  nb::class_<LawReplay>(module, "LawReplay")
      .def(nb::init<const std::vector<float>&, std::int16_t>(), "params"_a, "duty_full"_a)
      .def("load", &LawReplay::load, "words"_a, "hash"_a)
      .def("measure", &LawReplay::measure, "counts"_a)
      .def("engage", &LawReplay::engage, "front_raw"_a, "back_raw"_a)
      .def("set_parameter", &LawReplay::set_parameter, "index"_a, "value"_a)
      .def("news", &LawReplay::news)
      .def("update", &LawReplay::update, "setpoint_raw"_a)
      .def("outputs", &LawReplay::outputs);
  module.def("operate", &operate, "code"_a, "operands"_a);
}
