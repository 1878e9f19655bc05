// The board behind SimBoard, one millisecond at a time, as the simulated world drives it.
#include <nanobind/nanobind.h>
#include <nanobind/stl/array.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include <array>
#include <tuple>
#include <vector>

#include "board/due_board.hpp"
#include "python/bindings.hpp"

namespace nb = nanobind;
using namespace heli_due;

namespace {

using EdgeRow = std::tuple<double, int, int>;

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

nb::bytes take_sent(DueBoard& board) {
  std::string sent;
  for (std::uint8_t byte = 0; board.uart_transmit(byte);) sent.push_back(static_cast<char>(byte));
  return nb::bytes(sent.data(), sent.size());
}

}  // namespace

void bind_board(nb::module_& module) {
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
}
