// The filter and the smoother for Python.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/pair.h>
#include <nanobind/stl/vector.h>

#include <stdexcept>
#include <utility>
#include <vector>

#include "kalman.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace {

using heli_lab::LinearSystem;

template <int Dimensions>
using In = nb::ndarray<const double, nb::ndim<Dimensions>, nb::c_contig, nb::device::cpu>;
using Out = nb::ndarray<nb::numpy, double>;

// Throws ValueError in Python if an argument is wrong.
void require(bool holds, const char* what) {
  if (!holds) {
    throw std::invalid_argument(what);
  }
}

// Checks the shapes of all arrays against each other and points a LinearSystem at them. The arrays
// must outlive it.
LinearSystem system_of(const In<3>& transition, const In<4>& part_input, const In<3>& measurement,
                       const In<2>& measurement_variance, const In<1>& memory,
                       const In<1>& disturbance_variance, const In<1>& initial_variance,
                       const In<3>& drive, const In<3>& measured) {
  LinearSystem system;
  system.steps = transition.shape(0);
  system.states = transition.shape(1);
  system.outputs = measurement.shape(1);
  system.disturbances = memory.shape(0);
  system.parts = part_input.shape(0);
  system.kind = part_input.shape(3);
  system.columns = drive.shape(2);
  require(transition.shape(2) == system.states, "transition is not square");
  require(part_input.shape(1) == system.steps && part_input.shape(2) == system.states,
          "part_input has another shape than transition");
  require(system.parts > 0 && system.kind > 0 && system.disturbances % system.kind == 0,
          "memory must have one entry for each disturbance, of whole kinds");
  require(measurement.shape(0) == system.steps && system.outputs > 0 &&
              measurement.shape(2) == system.states,
          "measurement has another shape than transition");
  require(measurement_variance.shape(0) == system.steps &&
              measurement_variance.shape(1) == system.outputs,
          "measurement_variance has another shape than measurement");
  require(disturbance_variance.shape(0) == system.disturbances,
          "disturbance_variance must have one entry for each disturbance");
  require(initial_variance.shape(0) == system.states,
          "initial_variance must have one entry for each state");
  require(drive.shape(0) == system.steps && drive.shape(1) == system.states,
          "drive has another shape than transition");
  require(measured.shape(0) == system.steps && measured.shape(1) == system.outputs &&
              measured.shape(2) == system.columns && system.columns > 0,
          "measured has another shape than drive");
  system.transition = transition.data();
  system.part_input = part_input.data();
  system.measurement = measurement.data();
  system.measurement_variance = measurement_variance.data();
  system.memory = memory.data();
  system.disturbance_variance = disturbance_variance.data();
  system.initial_variance = initial_variance.data();
  system.drive = drive.data();
  system.measured = measured.data();
  return system;
}

// A new numpy array of zeros with two or three dimensions; numpy frees it.
Out array(std::size_t a, std::size_t b, std::size_t c, std::size_t dimensions) {
  auto* data = new double[a * b * (dimensions == 3 ? c : 1)]();
  const nb::capsule owner(data, [](void* p) noexcept { delete[] static_cast<double*>(p); });
  if (dimensions == 3) {
    return Out(data, {a, b, c}, owner);
  }
  return Out(data, {a, b}, owner);
}

// The same for Signals; `block` is the number of steps per block.
heli_lab::Signals signals_of(const In<3>& transition, const In<3>& input, const In<3>& rates,
                             std::size_t block) {
  heli_lab::Signals signals;
  signals.steps = transition.shape(0);
  signals.states = transition.shape(1);
  signals.columns = rates.shape(2);
  require(transition.shape(2) == signals.states, "transition is not square");
  require(input.shape(0) == signals.steps && input.shape(1) == signals.states &&
              input.shape(2) == signals.states,
          "input has another shape than transition");
  require(rates.shape(0) == signals.steps && rates.shape(1) == signals.states,
          "rates have another shape than transition");
  require(block > 0, "a block has steps");
  signals.transition = transition.data();
  signals.input = input.data();
  signals.rates = rates.data();
  return signals;
}

// Defines a function for Python that returns two arrays, [steps][states + disturbances].
template <void (*kFind)(const LinearSystem&, double*, double*)>
void def_of_states(nb::module_& module, const char* name) {
  module.def(
      name,
      [](const In<3>& transition, const In<4>& part_input, const In<3>& measurement,
         const In<2>& measurement_variance, const In<1>& memory, const In<1>& disturbance_variance,
         const In<1>& initial_variance, const In<3>& drive, const In<3>& measured) {
        const LinearSystem system =
            system_of(transition, part_input, measurement, measurement_variance, memory,
                      disturbance_variance, initial_variance, drive, measured);
        const std::size_t order = system.states + system.disturbances;
        Out first = array(system.steps, order, 1, 2);
        Out second = array(system.steps, order, 1, 2);
        {
          const nb::gil_scoped_release release;
          kFind(system, first.data(), second.data());
        }
        return std::make_pair(first, second);
      },
      "transition"_a, "part_input"_a, "measurement"_a, "measurement_variance"_a, "memory"_a,
      "disturbance_variance"_a, "initial_variance"_a, "drive"_a, "measured"_a);
}

}  // namespace

NB_MODULE(_kalman, module) {
  module.def(
      "filter",
      [](const In<3>& transition, const In<4>& part_input, const In<3>& measurement,
         const In<2>& measurement_variance, const In<1>& memory, const In<1>& disturbance_variance,
         const In<1>& initial_variance, const In<3>& drive, const In<3>& measured) {
        const LinearSystem system =
            system_of(transition, part_input, measurement, measurement_variance, memory,
                      disturbance_variance, initial_variance, drive, measured);
        Out innovations = array(system.steps, system.outputs, system.columns, 3);
        std::vector<double> log_variances(system.outputs, 0.0);
        {
          const nb::gil_scoped_release release;
          heli_lab::filter(system, innovations.data(), log_variances.data());
        }
        return std::make_pair(innovations, log_variances);
      },
      "transition"_a, "part_input"_a, "measurement"_a, "measurement_variance"_a, "memory"_a,
      "disturbance_variance"_a, "initial_variance"_a, "drive"_a, "measured"_a);
  module.def(
      "midpoint",
      [](const In<3>& jacobian, double step_s) {
        const std::size_t steps = jacobian.shape(0);
        const std::size_t states = jacobian.shape(1);
        require(jacobian.shape(2) == states, "jacobian is not square");
        Out transition = array(steps, states, states, 3);
        Out input = array(steps, states, states, 3);
        {
          const nb::gil_scoped_release release;
          heli_lab::midpoint(jacobian.data(), steps, states, step_s, transition.data(),
                             input.data());
        }
        return std::make_pair(transition, input);
      },
      "jacobian"_a, "step_s"_a);
  module.def(
      "over_blocks",
      [](const In<3>& transition, const In<3>& input, const In<3>& rates, std::size_t block) {
        const heli_lab::Signals signals = signals_of(transition, input, rates, block);
        Out out = array(signals.steps / block, signals.states, signals.columns, 3);
        {
          const nb::gil_scoped_release release;
          heli_lab::over_blocks(signals, block, out.data());
        }
        return out;
      },
      "transition"_a, "input"_a, "rates"_a, "block"_a);
  module.def(
      "block_response",
      [](const In<3>& transition, const In<3>& input, const In<3>& rates, std::size_t block) {
        const heli_lab::Signals signals = signals_of(transition, input, rates, block);
        const std::size_t blocks = signals.steps / block;
        Out over = array(blocks, signals.states, signals.states, 3);
        Out parts = array(block * blocks, signals.states, signals.columns, 3);
        {
          const nb::gil_scoped_release release;
          heli_lab::block_response(signals, block, over.data(), parts.data());
        }
        return std::make_pair(over, parts);
      },
      "transition"_a, "input"_a, "rates"_a, "block"_a);
  // Memory and variance of the disturbances differ per model; the system gets those of the first,
  // which are not used.
  module.def(
      "log_likelihoods",
      [](const In<3>& transition, const In<4>& part_input, const In<3>& measurement,
         const In<2>& measurement_variance, const In<2>& memory, const In<2>& disturbance_variance,
         const In<2>& scale, const In<1>& initial_variance, const In<3>& drive,
         const In<3>& measured) {
        const std::size_t models = memory.shape(0);
        require(models > 0 && disturbance_variance.shape(0) == models && scale.shape(0) == models,
                "memory, disturbance_variance and scale must have one row for each model");
        require(disturbance_variance.shape(1) == memory.shape(1) &&
                    scale.shape(1) == measurement.shape(1),
                "disturbance_variance or scale has another shape");
        const In<1> first(memory.data(), {memory.shape(1)}, nb::handle());
        const LinearSystem system =
            system_of(transition, part_input, measurement, measurement_variance, first, first,
                      initial_variance, drive, measured);
        Out values = array(models, system.outputs, 1, 2);
        {
          const nb::gil_scoped_release release;
          heli_lab::log_likelihoods(system, models, memory.data(), disturbance_variance.data(),
                                    scale.data(), values.data());
        }
        return values;
      },
      "transition"_a, "part_input"_a, "measurement"_a, "measurement_variance"_a, "memory"_a,
      "disturbance_variance"_a, "scale"_a, "initial_variance"_a, "drive"_a, "measured"_a);
  def_of_states<heli_lab::track>(module, "track");
  def_of_states<heli_lab::smooth>(module, "smooth");
  def_of_states<heli_lab::shock_scores>(module, "shock_scores");
}
