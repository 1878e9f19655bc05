// The state table, the shaping of setpoints, and a whole core on a board and with a law that the
// test decides.
#include <nanobind/nanobind.h>
#include <nanobind/stl/array.h>
#include <nanobind/stl/function.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include <array>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <optional>
#include <tuple>
#include <utility>

#include "control/controller.hpp"
#include "convert.hpp"
#include "flight/limits.hpp"
#include "flight/setpoints.hpp"
#include "flight/state_table.hpp"
#include "flight_code.hpp"
#include "harness_board.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace {

using heli::control::Bank;
using heli::control::ControlInput;
using heli::control::ControlOutput;
using heli::control::Quantity;
using heli_test::Bytes;
using heli_test::HarnessBoard;
using heli_test::ParamValues;
using heli_test::to_python;
using heli_test::Triple;

// Setpoints as the supervisor lets them advance, one tick at a time.
class Shaper {
 public:
  explicit Shaper(const ParamValues& values)
      : limits_(heli::flight::setpoint_limits_of(heli_test::params_from(values))) {
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

// A controller whose voltages the test decides; it remembers its inputs.
class ToldLaw final : public heli::control::Controller {
 public:
  void derive(heli::control::IdleLoop, const heli::params::Params& params, Bank bank) override {
    hover_V_[bank] = params.get(heli::link::Param::hover_V);
    if (while_deriving) while_deriving();
  }
  void init() override { ++inits; }
  ControlOutput update(const ControlInput& in, Bank bank) override {
    ++updates;
    seen = in;
    hover_V_of_update = hover_V_[bank];
    ControlOutput out{};
    out.front_V = Quantity::of(front_V);
    out.back_V = Quantity::of(back_V);
    out.pitch_setpoint_rad = Quantity::of(pitch_setpoint_rad);
    return out;
  }
  void shadow(const ControlInput& in, Bank, const ControlOutput& acting) override {
    ++shadows;
    seen = in;
    acting_front_V = acting.front_V.to_float();
  }
  void take_over() override { ++takeovers; }

  float front_V = 0.0F;
  float back_V = 0.0F;
  float pitch_setpoint_rad = 0.0F;
  std::function<void()> while_deriving;
  int inits = 0;
  int shadows = 0;
  int takeovers = 0;
  float acting_front_V = 0.0F;  // of the last shadow()
  int updates = 0;
  ControlInput seen{};
  float hover_V_of_update = 0.0F;  // the parameter as it stood in the bank of the last update()

 private:
  float hover_V_[heli::control::kBanks] = {};
};

Triple floats(const Quantity (&values)[heli::kAxisCount]) {
  return {values[0].to_float(), values[1].to_float(), values[2].to_float()};
}

// The flight code with two controllers of the test's: the first is the default.
struct ToldCode {
  ToldCode(heli::Board& board, ToldLaw& first, ToldLaw* second)
      : controllers(table(first, second)), core(board, simplex, uploaded) {}

  static heli::control::ControllerTable table(ToldLaw& first, ToldLaw* second) {
    if (second == nullptr) {
      return heli::control::ControllerTable({{"first", first}});
    }
    return heli::control::ControllerTable({{"first", first}, {"second", *second}});
  }

  heli::control::ControllerTable controllers;
  heli::law::UploadedLaw uploaded;
  heli::law::Simplex simplex{controllers, uploaded};
  heli::Core core;
};

// The flight code with its encoders, stop input and serial bytes in the test's hands; with
// controllers of the test's, or else what a board flies.
class CoreHarness {
 public:
  CoreHarness(ToldLaw* law, ToldLaw* other, std::int16_t duty_full, std::size_t page_bytes)
      : board_(duty_full, page_bytes) {
    if (law != nullptr) {
      told_.emplace(board_, *law, other);
    } else {
      code_.emplace(board_);
    }
    core().start();
  }

  // As the timer's interrupt, which may come at any moment.
  void interrupt(bool late) { core().tick({100, late}); }

  void tick(std::size_t count, bool late) {
    for (std::size_t i = 0; i < count; ++i) {
      interrupt(late);
      core().poll();
    }
  }

  void encoders(const std::array<std::int32_t, heli::kAxisCount>& counts,
                const std::array<std::uint32_t, heli::kAxisCount>& illegal) {
    for (std::size_t axis = 0; axis < heli::kAxisCount; ++axis) {
      board_.encoders.count[axis] = counts[axis];
      board_.encoders.illegal[axis] = illegal[axis];
    }
  }

  void overload(std::uint32_t edges) { board_.encoders.overload_edges = edges; }

  void receive(const nb::bytes& bytes) {
    const std::uint8_t* data = heli_test::data_of(bytes);
    board_.received.insert(board_.received.end(), data, data + bytes.size());
  }

  nb::bytes sent() {
    board_.room = kRoom_bytes;
    return to_python(std::exchange(board_.sent, {}));
  }

  std::tuple<int, int, bool> motors() const {
    return {board_.motors.front_duty, board_.motors.back_duty, board_.motors.enable};
  }

  int state() { return static_cast<int>(core().state()); }
  void stop_input(bool active) { board_.stop_input = active; }

 private:
  // More than is sent between two calls of sent(), so that nothing is dropped.
  static constexpr std::size_t kRoom_bytes = 1U << 20U;

  heli::Core& core() { return told_ ? told_->core : code_->core; }

  HarnessBoard board_;
  std::optional<ToldCode> told_;
  std::optional<heli::FlightCode> code_;
};

}  // namespace

void bind_flight(nb::module_& module) {
  nb::module_ m = module.def_submodule("flight", "A whole core, and parts of its supervisor.");
  // An arm at rest, all else as it should be: through a link the age is never more than a tick.
  m.def(
      "fault_before_arming",
      [](std::uint32_t link_age_ticks) {
        const heli::flight::Limits limits = heli::flight::limits_of(heli::params::Params{});
        heli::flight::Observation seen{};
        seen.angle_rad[heli::kElevation] = limits.rest_rad;
        seen.params_usable = true;
        seen.link_age_ticks = link_age_ticks;
        const heli::flight::Verdict verdict = heli::flight::check_before_arming(seen, limits, 0);
        return std::tuple(static_cast<int>(verdict.fault), verdict.value);
      },
      "link_age_ticks"_a);
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
      "state"_a, "trigger"_a);
  nb::class_<Shaper>(m, "Shaper")
      .def(nb::init<const ParamValues&>(), "params"_a)
      .def("aim", &Shaper::aim, "target_rad"_a, "ahead_ticks"_a)
      .def("advance", &Shaper::advance);
  nb::class_<ToldLaw>(m, "ToldLaw")
      .def(nb::init<>())
      .def_rw("front_V", &ToldLaw::front_V)
      .def_rw("back_V", &ToldLaw::back_V)
      .def_rw("pitch_setpoint_rad", &ToldLaw::pitch_setpoint_rad)
      .def_rw("while_deriving", &ToldLaw::while_deriving, nb::arg().none())
      .def_ro("inits", &ToldLaw::inits)
      .def_ro("shadows", &ToldLaw::shadows)
      .def_ro("takeovers", &ToldLaw::takeovers)
      .def_ro("acting_front_V", &ToldLaw::acting_front_V)
      .def_ro("updates", &ToldLaw::updates)
      .def_ro("hover_V_of_update", &ToldLaw::hover_V_of_update)
      .def_prop_ro("angle_rad", [](const ToldLaw& law) { return floats(law.seen.angle_rad); })
      .def_prop_ro("rate_rad_s", [](const ToldLaw& law) { return floats(law.seen.rate_rad_s); })
      .def_prop_ro("setpoint_rad", [](const ToldLaw& law) { return floats(law.seen.setpoint_rad); })
      .def_prop_ro("axes", [](const ToldLaw& law) { return law.seen.axes; });
  nb::class_<CoreHarness>(m, "Harness")
      .def(nb::init<ToldLaw*, ToldLaw*, std::int16_t, std::size_t>(), "law"_a.none(),
           "other"_a.none(), "duty_full"_a, "page_bytes"_a, nb::keep_alive<1, 2>(),
           nb::keep_alive<1, 3>())
      .def("interrupt", &CoreHarness::interrupt, "late"_a = false)
      .def("tick", &CoreHarness::tick, "count"_a = 1, "late"_a = false)
      .def("encoders", &CoreHarness::encoders, "counts"_a, "illegal"_a)
      .def("overload", &CoreHarness::overload, "edges"_a)
      .def("receive", &CoreHarness::receive, "bytes"_a)
      .def("sent", &CoreHarness::sent)
      .def("motors", &CoreHarness::motors)
      .def("stop_input", &CoreHarness::stop_input, "active"_a)
      .def_prop_ro("state", &CoreHarness::state);
}
