// The control law, the excitation, the state table and a whole core on a desk, for the tests.
#include <nanobind/ndarray.h>
#include <nanobind/stl/array.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include <array>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <stdexcept>
#include <tuple>
#include <utility>
#include <vector>

#include "bindings.hpp"
#include "control/cascade.hpp"
#include "control/constants.hpp"
#include "control/excitation.hpp"
#include "control/fixed.hpp"
#include "control/math.hpp"
#include "control/mixer.hpp"
#include "control/rate_filter.hpp"
#include "core.hpp"
#include "flight/setpoints.hpp"
#include "flight/state_table.hpp"
#include "native_board.hpp"
#include "params/params.hpp"

namespace nb = nanobind;

namespace {

using heli::control::Quantity;
using Triple = std::array<float, heli::kAxisCount>;
using ParamValues = std::vector<std::tuple<int, float>>;

heli::params::Params params_from(const ParamValues& values) {
  heli::params::Params params;
  for (const auto& [index, value] : values) {
    if (params.set(static_cast<heli::link::Param>(index), value, true) != heli::link::Result::ok) {
      throw std::invalid_argument("parameter refused");
    }
  }
  return params;
}

class Law {
 public:
  explicit Law(const ParamValues& values)
      : constants_(heli::control::constants_of(params_from(values))) {}

  auto update(const Triple& angle_rad, const Triple& rate_rad_s, const Triple& setpoint_rad,
              const Triple& setpoint_rate_rad_s, const Triple& setpoint_acceleration_rad_s2,
              std::uint8_t axes, const std::array<float, 2>& open_V,
              const std::array<float, 2>& excitation_V) {
    heli::control::ControlInput in{};
    for (std::size_t axis = 0; axis < heli::kAxisCount; ++axis) {
      in.angle_rad[axis] = Quantity::of(angle_rad[axis]);
      in.rate_rad_s[axis] = Quantity::of(rate_rad_s[axis]);
      in.setpoint_rad[axis] = Quantity::of(setpoint_rad[axis]);
      in.setpoint_rate_rad_s[axis] = Quantity::of(setpoint_rate_rad_s[axis]);
      in.setpoint_acceleration_rad_s2[axis] = Quantity::of(setpoint_acceleration_rad_s2[axis]);
    }
    in.axes = axes;
    in.open_front_V = Quantity::of(open_V[0]);
    in.open_back_V = Quantity::of(open_V[1]);
    in.excitation_front_V = Quantity::of(excitation_V[0]);
    in.excitation_back_V = Quantity::of(excitation_V[1]);
    const heli::control::ControlOutput out = law_.update(in, constants_);
    return std::make_tuple(out.front_V.to_float(), out.back_V.to_float(),
                           out.pitch_setpoint_rad.to_float(), out.front_saturated,
                           out.back_saturated, out.pitch_limited);
  }

 private:
  heli::control::Constants constants_;
  heli::control::Cascade law_;
};

// Setpoints as the supervisor lets them advance, one tick at a time.
class Shaper {
 public:
  explicit Shaper(const ParamValues& values)
      : limits_(heli::flight::setpoint_limits_of(params_from(values))) {
    setpoints_.start_at({});
  }

  bool aim(const Triple& target_rad, std::uint32_t ahead_ticks) {
    const Quantity target[heli::kAxisCount] = {
        Quantity::of(target_rad[0]), Quantity::of(target_rad[1]), Quantity::of(target_rad[2])};
    return setpoints_.aim(target, ahead_ticks, 0, limits_);
  }

  // Angle, rate and acceleration of each axis.
  std::array<Triple, heli::kAxisCount> advance() {
    setpoints_.advance(limits_);
    std::array<Triple, heli::kAxisCount> out{};
    for (std::size_t axis = 0; axis < heli::kAxisCount; ++axis) {
      const heli::flight::Setpoint s = setpoints_.of(axis);
      out[axis] = {s.angle_rad.to_float(), s.rate_rad_s.to_float(),
                   s.acceleration_rad_s2.to_float()};
    }
    return out;
  }

 private:
  heli::flight::SetpointLimits limits_;
  heli::flight::Setpoints setpoints_;
};

nb::ndarray<nb::numpy, float, nb::ndim<2>> excitation(std::uint8_t kind, float front_V,
                                                      float back_V, float start_Hz, float stop_Hz,
                                                      float duration_s, std::uint32_t seed,
                                                      std::size_t ticks) {
  heli::link::ExciteMessage message;
  message.kind = kind;
  message.front_V = front_V;
  message.back_V = back_V;
  message.start_Hz = start_Hz;
  message.stop_Hz = stop_Hz;
  message.duration_s = duration_s;
  message.seed = seed;
  heli::control::Exciter exciter;
  exciter.start(message);
  auto* values = new float[2 * ticks];
  const nb::capsule owner(values, [](void* p) noexcept { delete[] static_cast<float*>(p); });
  for (std::size_t tick = 0; tick < ticks; ++tick) {
    const heli::control::ExcitationValue value = exciter.next();
    values[2 * tick] = value.front_V.to_float();
    values[2 * tick + 1] = value.back_V.to_float();
  }
  return {values, {ticks, 2}, owner};
}

// The flight code with its encoders, stop input and serial bytes in the test's hands.
class Desk {
 public:
  Desk() : core_(board_) { core_.start(); }

  void tick(std::size_t count, bool late) {
    for (std::size_t i = 0; i < count; ++i) {
      core_.tick({100, late});
      core_.poll();
    }
  }

  void encoders(const std::array<std::int32_t, 3>& counts,
                const std::array<std::uint16_t, 3>& illegal) {
    for (std::size_t axis = 0; axis < heli::kAxisCount; ++axis) {
      board_.encoders.count[axis] = counts[axis];
      board_.encoders.illegal[axis] = illegal[axis];
    }
  }

  void receive(const nb::bytes& bytes) {
    const auto* data = reinterpret_cast<const std::uint8_t*>(bytes.data());
    for (std::size_t i = 0; i < bytes.size(); ++i) {
      board_.rx.push(data[i]);
    }
  }

  nb::bytes sent() {
    std::vector<char> bytes;
    while (!board_.tx.empty()) {
      bytes.push_back(static_cast<char>(board_.tx.pop()));
    }
    return nb::bytes(bytes.data(), bytes.size());
  }

  std::tuple<int, int, bool> motors() const {
    return {board_.motors.front_duty, board_.motors.back_duty, board_.motors.enable};
  }

  int state() const { return static_cast<int>(core_.state()); }
  void stop_input(bool active) { board_.stop_input = active; }

 private:
  heli_sim::MemoryBoard board_;
  heli::Core core_;
};

}  // namespace

void bind_control(nb::module_& module) {
  nb::module_ m = module.def_submodule("control", "The flight code's control law, piece by piece.");
  nb::class_<Law>(m, "Law")
      .def(nb::init<const ParamValues&>(), nb::arg("params"))
      .def("update", &Law::update, nb::arg("angle_rad"), nb::arg("rate_rad_s"),
           nb::arg("setpoint_rad"), nb::arg("setpoint_rate_rad_s"),
           nb::arg("setpoint_acceleration_rad_s2"), nb::arg("axes"), nb::arg("open_V"),
           nb::arg("excitation_V"));
  nb::class_<Shaper>(m, "Shaper")
      .def(nb::init<const ParamValues&>(), nb::arg("params"))
      .def("aim", &Shaper::aim, nb::arg("target_rad"), nb::arg("ahead_ticks"))
      .def("advance", &Shaper::advance);
  nb::class_<heli::control::RateFilter>(m, "RateFilter")
      .def(nb::init<>())
      .def(
          "update",
          [](heli::control::RateFilter& self, float angle_rad, float smoothing) {
            return self.update(Quantity::of(angle_rad), heli::control::Share::of(smoothing))
                .to_float();
          },
          nb::arg("angle_rad"), nb::arg("smoothing"));
  m.def(
      "mix",
      [](float collective_V, float differential_V, float least_V, float most_V,
         float differential_max_V) {
        const heli::control::Mixed mixed = heli::control::mix(
            Quantity::of(collective_V), Quantity::of(differential_V),
            heli::control::MixerLimits::of(Quantity::of(least_V), Quantity::of(most_V),
                                           Quantity::of(differential_max_V)));
        return std::make_tuple(mixed.front_V.to_float(), mixed.back_V.to_float(),
                               mixed.collective_V.to_float(), mixed.differential_V.to_float());
      },
      nb::arg("collective_V"), nb::arg("differential_V"), nb::arg("least_V"), nb::arg("most_V"),
      nb::arg("differential_max_V"));
  m.def(
      "motor_from_lift_V",
      [](float lift_V, float dead_zone_V) {
        return heli::control::motor_from_lift_V(Quantity::of(lift_V),
                                                heli::control::DeadZone::of(dead_zone_V))
            .to_float();
      },
      nb::arg("lift_V"), nb::arg("dead_zone_V"));
  m.def(
      "quantity", [](float value) { return heli::control::quantity_of(value).raw(); },
      nb::arg("value"), "Bits of the nearest quantity.");
  m.def(
      "quantity_sum",
      [](std::int32_t a, std::int32_t b) {
        return (Quantity::from_raw(a) + Quantity::from_raw(b)).raw();
      },
      nb::arg("a"), nb::arg("b"), "Of the bits of two quantities.");
  m.def(
      "quantity_difference",
      [](std::int32_t a, std::int32_t b) {
        return (Quantity::from_raw(a) - Quantity::from_raw(b)).raw();
      },
      nb::arg("a"), nb::arg("b"), "Of the bits of two quantities.");
  m.def(
      "quantity_product",
      [](std::int32_t gain, std::int32_t quantity) {
        return (heli::control::Gain::from_raw(gain) * Quantity::from_raw(quantity)).raw();
      },
      nb::arg("gain"), nb::arg("quantity"), "Of the bits of a gain and of a quantity.");
  m.def("square_root", &heli::control::square_root, nb::arg("value"));
  m.def("reciprocal", &heli::control::reciprocal, nb::arg("value"));
  m.def("excitation", &excitation, nb::arg("kind"), nb::arg("front_V"), nb::arg("back_V"),
        nb::arg("start_Hz"), nb::arg("stop_Hz"), nb::arg("duration_s"), nb::arg("seed"),
        nb::arg("ticks"));
  m.def(
      "next_state",
      [](int state, int trigger) -> std::optional<int> {
        const std::uint8_t next = heli::flight::next_state(
            static_cast<heli::link::State>(state), static_cast<heli::link::Trigger>(trigger));
        if (next == heli::flight::kRefused) {
          return std::nullopt;
        }
        return next;
      },
      nb::arg("state"), nb::arg("trigger"));
  nb::class_<Desk>(m, "Desk")
      .def(nb::init<>())
      .def("tick", &Desk::tick, nb::arg("count") = 1, nb::arg("late") = false)
      .def("encoders", &Desk::encoders, nb::arg("counts"), nb::arg("illegal"))
      .def("receive", &Desk::receive, nb::arg("bytes"))
      .def("sent", &Desk::sent)
      .def("motors", &Desk::motors)
      .def("stop_input", &Desk::stop_input, nb::arg("active"))
      .def_prop_ro("state", &Desk::state);
}
