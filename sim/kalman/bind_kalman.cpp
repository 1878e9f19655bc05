// The filter and the smoother for Python.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/array.h>
#include <nanobind/stl/pair.h>

#include <array>
#include <stdexcept>
#include <utility>

#include "kalman.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace {

using heli_lab::LinearSystem;

template <int Dimensions>
using In = nb::ndarray<const double, nb::ndim<Dimensions>, nb::c_contig, nb::device::cpu>;
using Out = nb::ndarray<nb::numpy, double>;

void require(bool holds, const char* what) {
  if (!holds) {
    throw std::invalid_argument(what);
  }
}

LinearSystem system_of(const In<3>& transition, const In<3>& torque_input, const In<3>& measurement,
                       const In<2>& measurement_variance, const In<1>& memory,
                       const In<1>& torque_variance, const In<1>& initial_variance,
                       const In<3>& drive, const In<3>& measured) {
  LinearSystem system;
  system.steps = transition.shape(0);
  system.states = transition.shape(1);
  system.torques = torque_input.shape(2);
  system.columns = drive.shape(2);
  require(transition.shape(2) == system.states, "transition is not square");
  require(torque_input.shape(0) == system.steps && torque_input.shape(1) == system.states,
          "torque_input has another shape than transition");
  require(measurement.shape(0) == system.steps && measurement.shape(1) == 3 &&
              measurement.shape(2) == system.states,
          "measurement has another shape than transition");
  require(measurement_variance.shape(0) == system.steps && measurement_variance.shape(1) == 3,
          "measurement_variance has another shape than measurement");
  require(memory.shape(0) == system.torques && torque_variance.shape(0) == system.torques,
          "memory and torque_variance must have one entry a torque");
  require(initial_variance.shape(0) == system.states,
          "initial_variance must have one entry a state");
  require(drive.shape(0) == system.steps && drive.shape(1) == system.states,
          "drive has another shape than transition");
  require(measured.shape(0) == system.steps && measured.shape(1) == 3 &&
              measured.shape(2) == system.columns && system.columns > 0,
          "measured has another shape than drive");
  system.transition = transition.data();
  system.torque_input = torque_input.data();
  system.measurement = measurement.data();
  system.measurement_variance = measurement_variance.data();
  system.memory = memory.data();
  system.torque_variance = torque_variance.data();
  system.initial_variance = initial_variance.data();
  system.drive = drive.data();
  system.measured = measured.data();
  return system;
}

Out array(std::size_t a, std::size_t b, std::size_t c, std::size_t dimensions) {
  auto* data = new double[a * b * (dimensions == 3 ? c : 1)]();
  const nb::capsule owner(data, [](void* p) noexcept { delete[] static_cast<double*>(p); });
  if (dimensions == 3) {
    return Out(data, {a, b, c}, owner);
  }
  return Out(data, {a, b}, owner);
}

}  // namespace

NB_MODULE(_kalman, module) {
  module.def(
      "filter",
      [](const In<3>& transition, const In<3>& torque_input, const In<3>& measurement,
         const In<2>& measurement_variance, const In<1>& memory, const In<1>& torque_variance,
         const In<1>& initial_variance, const In<3>& drive, const In<3>& measured) {
        const LinearSystem system =
            system_of(transition, torque_input, measurement, measurement_variance, memory,
                      torque_variance, initial_variance, drive, measured);
        Out innovations = array(system.steps, 3, system.columns, 3);
        std::array<double, 3> log_variances{};
        {
          const nb::gil_scoped_release release;
          heli_lab::filter(system, innovations.data(), log_variances.data());
        }
        return std::make_pair(innovations, log_variances);
      },
      "transition"_a, "torque_input"_a, "measurement"_a, "measurement_variance"_a, "memory"_a,
      "torque_variance"_a, "initial_variance"_a, "drive"_a, "measured"_a);
  module.def(
      "track",
      [](const In<3>& transition, const In<3>& torque_input, const In<3>& measurement,
         const In<2>& measurement_variance, const In<1>& memory, const In<1>& torque_variance,
         const In<1>& initial_variance, const In<3>& drive, const In<3>& measured) {
        const LinearSystem system =
            system_of(transition, torque_input, measurement, measurement_variance, memory,
                      torque_variance, initial_variance, drive, measured);
        const std::size_t order = system.states + system.torques;
        Out predicted = array(system.steps, order, 1, 2);
        Out filtered = array(system.steps, order, 1, 2);
        {
          const nb::gil_scoped_release release;
          heli_lab::track(system, predicted.data(), filtered.data());
        }
        return std::make_pair(predicted, filtered);
      },
      "transition"_a, "torque_input"_a, "measurement"_a, "measurement_variance"_a, "memory"_a,
      "torque_variance"_a, "initial_variance"_a, "drive"_a, "measured"_a);
  module.def(
      "smooth",
      [](const In<3>& transition, const In<3>& torque_input, const In<3>& measurement,
         const In<2>& measurement_variance, const In<1>& memory, const In<1>& torque_variance,
         const In<1>& initial_variance, const In<3>& drive, const In<3>& measured) {
        const LinearSystem system =
            system_of(transition, torque_input, measurement, measurement_variance, memory,
                      torque_variance, initial_variance, drive, measured);
        const std::size_t order = system.states + system.torques;
        Out mean = array(system.steps, order, 1, 2);
        Out variance = array(system.steps, order, 1, 2);
        {
          const nb::gil_scoped_release release;
          heli_lab::smooth(system, mean.data(), variance.data());
        }
        return std::make_pair(mean, variance);
      },
      "transition"_a, "torque_input"_a, "measurement"_a, "measurement_variance"_a, "memory"_a,
      "torque_variance"_a, "initial_variance"_a, "drive"_a, "measured"_a);
}
