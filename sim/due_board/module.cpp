// heli_sim.due._due_board: the emulated Due behind SimBoard, and its wiring.
#include <nanobind/nanobind.h>
#include <nanobind/stl/array.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include <array>
#include <exception>
#include <tuple>
#include <vector>

#include "due_board.hpp"
#include "wiring.hpp"

namespace nb = nanobind;
using due_emulator::Due;
using heli_sim::DueBoard;

namespace {

// Time in us, axis, direction.
using EdgeRow = std::tuple<double, int, int>;

// A whole millisecond: both parts, and the motors at its end (front duty, back duty, enable).
std::tuple<double, double, bool> run(DueBoard& board, const std::array<std::int32_t, 3>& count,
                                     const std::vector<EdgeRow>& edges) {
  std::vector<heli_sim::Edge> list;
  for (const auto& [time_us, axis, direction] : edges) {
    list.push_back({time_us, static_cast<std::uint8_t>(axis), static_cast<std::int8_t>(direction)});
  }
  board.tick(count.data());
  board.rest(list.data(), list.size());
  const heli_sim::MotorOutput motors = board.motors();
  return {motors.front_duty, motors.back_duty, motors.enable};
}

// The bytes that the program has sent and that have left by now.
nb::bytes take_sent(DueBoard& board) {
  std::string sent;
  for (std::uint8_t byte = 0; board.uart_transmit(byte);) sent.push_back(static_cast<char>(byte));
  return nb::bytes(sent.data(), sent.size());
}

// This extension has a copy of the emulator, and on some systems a C++ class has another identity
// in each extension: what its copy throws becomes the exception of the emulator's package here.
void raise_stop(const std::exception_ptr& thrown, void* stop) {
  try {
    std::rethrow_exception(thrown);
  } catch (const due_emulator::Stop& error) {
    PyErr_SetString(static_cast<PyObject*>(stop), error.what());
  }
}

}  // namespace

NB_MODULE(_due_board, module) {
  module.doc() = "The emulated Due as a board of the simulated world.";
  // These modules have the classes SimBoard and Due, which the signatures below name.
  nb::module_::import_("heli_sim._native");
  const nb::object emulator = nb::module_::import_("due_emulator._due");
  nb::register_exception_translator(raise_stop, nb::object(emulator.attr("Stop")).release().ptr());

  nb::class_<DueBoard, heli_sim::SimBoard>(module, "DueBoard",
                                           "The emulated Due as a board of the simulated world.")
      .def(nb::init<>())
      .def("run", &run, nb::arg("count"), nb::arg("edges"),
           "One millisecond: the duties and the enable at its end.")
      .def(
          "receive",
          [](DueBoard& board, const nb::bytes& data) {
            for (std::size_t i = 0; i < data.size(); ++i) {
              board.uart_receive(static_cast<std::uint8_t>(data.c_str()[i]));
            }
          },
          nb::arg("data"))
      .def("align", &DueBoard::align, nb::arg("handler"))
      .def("take_sent", &take_sent)
      .def_prop_ro("due", &DueBoard::due, nb::rv_policy::reference_internal);

  module.def("wire", &heli_sim::wire, nb::arg("due"),
             "Put the helicopter's encoders, pull-downs and stop switch on the pins of a board.");
  module.def("motor_duty", &heli_sim::motor_duty, nb::arg("due"), nb::arg("motor"));
  module.def("motor_enabled", &heli_sim::motor_enabled, nb::arg("due"), nb::arg("motor"));
}
