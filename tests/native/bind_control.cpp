// The control law and the excitation, piece by piece.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/array.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include <array>
#include <cstddef>
#include <cstdint>
#include <tuple>
#include <vector>

#include "control/cascade.hpp"
#include "control/controller.hpp"
#include "control/excitation.hpp"
#include "control/fixed.hpp"
#include "control/loop.hpp"
#include "control/math.hpp"
#include "control/mixer.hpp"
#include "convert.hpp"

namespace nb = nanobind;

namespace heli::control {

// Lets a test derive a controller's constants, which on a board only the core's idle loop can.
struct IdleLoopOfTests {
  static constexpr IdleLoop make() { return IdleLoop(nullptr); }
};

}  // namespace heli::control

namespace {

using heli::control::Quantity;
using heli_test::ParamValues;
using heli_test::Triple;

// The cascade by itself.
class Law {
 public:
  explicit Law(const ParamValues& values) {
    law_.derive(heli::control::IdleLoopOfTests::make(), heli_test::params_from(values), kBank);
  }

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
    const heli::control::ControlOutput out = law_.update(in, kBank);
    return std::make_tuple(out.front_V.to_float(), out.back_V.to_float(),
                           out.pitch_setpoint_rad.to_float(), out.front_saturated,
                           out.back_saturated, out.pitch_limited);
  }

 private:
  static constexpr heli::control::Bank kBank = 0;

  heli::control::Cascade law_;
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

}  // namespace

void bind_control(nb::module_& module) {
  nb::module_ m = module.def_submodule("control", "The flight code's control law, piece by piece.");
  nb::class_<Law>(m, "Law")
      .def(nb::init<const ParamValues&>(), nb::arg("params"))
      .def("update", &Law::update, nb::arg("angle_rad"), nb::arg("rate_rad_s"),
           nb::arg("setpoint_rad"), nb::arg("setpoint_rate_rad_s"),
           nb::arg("setpoint_acceleration_rad_s2"), nb::arg("axes"), nb::arg("open_V"),
           nb::arg("excitation_V"));
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
}
