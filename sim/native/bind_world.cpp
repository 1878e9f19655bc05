// The Python module: world, plant steps and their counters; bind_board.cpp adds the boards.
#include <nanobind/nanobind.h>
#include <nanobind/stl/array.h>
#include <nanobind/stl/pair.h>
#include <nanobind/stl/shared_ptr.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include <algorithm>
#include <array>
#include <memory>
#include <stdexcept>
#include <string>
#include <vector>

#include "native_board.hpp"
#include "world.hpp"

namespace nb = nanobind;
using namespace nb::literals;

void bind_board(nb::module_& module);  // bind_board.cpp

namespace {

using heli_sim::CompiledStep;
using heli_sim::EncoderConfig;
using heli_sim::NativeBoard;
using heli_sim::PlantStep;
using heli_sim::SimBoard;
using heli_sim::World;

using Axes = std::array<double, heli::kAxisCount>;

// A Python callable as plant: about 50 times slower than a compiled one.
class CallbackStep final : public PlantStep {
 public:
  CallbackStep(nb::object callable, std::size_t state_count, std::size_t parameter_count)
      : callable_(std::move(callable)),
        state_count_(state_count),
        parameter_count_(parameter_count) {}
  CallbackStep(const CallbackStep&) = delete;
  CallbackStep& operator=(const CallbackStep&) = delete;
  ~CallbackStep() override {
    nb::gil_scoped_acquire gil;
    callable_.reset();
  }

  // Called without the GIL, by World::advance(); takes it for the call.
  void step(const double* state, const double* volts_V, const double* locked,
            const double* parameters, double* next_state, double* angles_rad) override {
    nb::gil_scoped_acquire gil;
    const nb::object result = callable_(
        std::vector<double>(state, state + state_count_), std::vector<double>(volts_V, volts_V + 2),
        std::vector<double>(locked, locked + heli::kAxisCount),
        std::vector<double>(parameters, parameters + parameter_count_));
    const auto [next, angles] =
        nb::cast<std::pair<std::vector<double>, std::vector<double>>>(result);
    if (next.size() != state_count_ || angles.size() != heli::kAxisCount) {
      throw std::invalid_argument("the plant returned vectors of another length");
    }
    std::copy(next.begin(), next.end(), next_state);
    std::copy(angles.begin(), angles.end(), angles_rad);
  }
  std::size_t state_count() const override { return state_count_; }
  std::size_t parameter_count() const override { return parameter_count_; }

 private:
  nb::object callable_;
  std::size_t state_count_;
  std::size_t parameter_count_;
};

// Python's two vectors as a configuration.
EncoderConfig encoder_config(const Axes& counts_per_rad, const Axes& offset_count) {
  EncoderConfig config{};
  std::copy(counts_per_rad.begin(), counts_per_rad.end(), config.counts_per_rad);
  std::copy(offset_count.begin(), offset_count.end(), config.offset_count);
  return config;
}

// World.__init__: builds a world at `place`, with a native board if none is given.
void make_world(World* place, std::shared_ptr<PlantStep> step, std::vector<double> state,
                std::vector<double> parameters, double supply_V, double dead_band,
                const Axes& counts_per_rad, const Axes& offset_count,
                std::shared_ptr<SimBoard> board) {
  if (!board) board = std::make_shared<NativeBoard>("", false);
  new (place) World(std::move(board), std::move(step), std::move(state), std::move(parameters),
                    {supply_V, dead_band}, encoder_config(counts_per_rad, offset_count));
}

// Hands the bytes `rx` of the host to the serial line and lets up to `ticks` milliseconds pass.
// Returns how many passed, and the bytes that reached the host.
nb::tuple advance(World& world, std::uint64_t ticks, const nb::bytes& rx, bool until_output,
                  std::uint64_t least) {
  world.line().host_write(reinterpret_cast<const std::uint8_t*>(rx.c_str()), rx.size());
  std::vector<std::uint8_t> to_host;
  std::uint64_t passed = 0;
  {
    nb::gil_scoped_release no_gil;
    passed = world.advance(ticks, until_output, least, to_host);
  }
  return nb::make_tuple(passed, nb::bytes(to_host.data(), to_host.size()));
}

// The serial line's counters since the world was made, by name.
nb::dict line_counters(World& world) {
  const heli_sim::LineCounters& counters = world.line().counters();
  nb::dict result;
  result["to_board_bytes"] = counters.to_board_bytes;
  result["to_host_bytes"] = counters.to_host_bytes;
  result["to_host_overflow"] = counters.to_host_overflow;
  result["to_board_overflow"] = counters.to_board_overflow;
  return result;
}

}  // namespace

NB_MODULE(_native, module) {
  module.doc() = "The flight code compiled for this machine, and the world it flies in.";
  bind_board(module);
  nb::class_<PlantStep>(module, "PlantStep", "One millisecond of the rig.");
  nb::class_<CompiledStep, PlantStep>(module, "CompiledStep",
                                      "A CasADi function in a shared library.")
      .def(nb::init<const std::string&, const std::string&>(), "library"_a, "name"_a);
  nb::class_<CallbackStep, PlantStep>(
      module, "CallbackStep",
      "A Python callable (state, volts_V, locked, parameters) -> (next state, angles_rad).")
      .def(nb::init<nb::object, std::size_t, std::size_t>(), "callable"_a, "state_count"_a,
           "parameter_count"_a);

  nb::class_<World>(module, "World", "Board, serial line, power stage and rig on one 1 ms clock.")
      .def("__init__", &make_world, "step"_a, "state"_a, "parameters"_a, nb::kw_only(),
           "supply_V"_a, "dead_band"_a, "counts_per_rad"_a, "offset_count"_a,
           "board"_a = nb::none())
      .def("advance", &advance, "ticks"_a, "rx"_a, "until_output"_a = false, "least"_a = 1,
           "Hand `rx` to the line and let time pass; (milliseconds passed, bytes at the host).")
      .def(
          "unplug", [](World& self) { self.line().clear(); },
          "Lose every byte that is under way, as pulling the USB plug does.")
      .def_prop_ro("tick", &World::tick)
      .def_prop_rw("state", &World::state, &World::set_state)
      .def_prop_rw("parameters", &World::parameters, &World::set_parameters)
      .def_prop_ro("volts_V", &World::volts_V)
      .def("wire_motors", &World::set_wiring, "swapped"_a, "signs"_a,
           "Plug the motors' cables: exchanged with each other, or each with its leads exchanged.")
      .def_prop_rw("hand_rad", &World::hand_rad, &World::set_hand,
                   "Angles to which a hand turns the axes, and holds them; NaN lets go.")
      .def_prop_ro("counts",
                   [](World& self) {
                     const std::int32_t* count = self.encoders().count();
                     return std::array<std::int32_t, 3>{count[0], count[1], count[2]};
                   })
      .def_prop_rw(
          "locked",
          [](World& self) {
            const Axes& locked = self.locked();
            return std::array<bool, 3>{locked[0] != 0.0, locked[1] != 0.0, locked[2] != 0.0};
          },
          [](World& self, const std::array<bool, 3>& locked) {
            self.set_locked({locked[0] ? 1.0 : 0.0, locked[1] ? 1.0 : 0.0, locked[2] ? 1.0 : 0.0});
          })
      .def_prop_rw(
          "encoders_out",
          [](World& self) {
            const heli_sim::Encoders& encoders = self.encoders();
            return std::array<bool, 3>{encoders.out(0), encoders.out(1), encoders.out(2)};
          },
          [](World& self, const std::array<bool, 3>& out) {
            for (std::size_t axis = 0; axis < heli::kAxisCount; ++axis) {
              self.set_encoder_out(axis, out[axis]);
            }
          })
      .def("support_below", &World::support_below, "elevation_rad"_a,
           "Hold the arm on its table below this elevation while the motors are off.")
      .def_prop_rw("supply_on", &World::supply_on, &World::set_supply_on)
      .def_prop_rw(
          "host_reading", [](World& self) { return self.line().host_reading(); },
          [](World& self, bool reading) { self.line().set_host_reading(reading); })
      .def_prop_ro("to_board_waiting", [](World& self) { return self.line().to_board_waiting(); })
      .def("line_counters", &line_counters);
}
