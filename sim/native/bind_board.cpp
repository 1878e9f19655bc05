// Boards of the simulated world, as Python sees them. heli_sim.due._due_board adds the Due.
#include <nanobind/nanobind.h>
#include <nanobind/stl/array.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/tuple.h>

#include <algorithm>
#include <array>
#include <cstring>
#include <optional>
#include <stdexcept>
#include <string>
#include <tuple>

#include "native_board.hpp"
#include "sim_board.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace {

using heli_sim::MemoryBoard;
using heli_sim::NativeBoard;
using heli_sim::SimBoard;

// The content of the flash, for Python.
nb::bytes flash_bytes(NativeBoard& self) {
  return nb::bytes(self.memory().flash.data(), self.memory().flash.size());
}

// Replaces the content of the flash; `flash` must have its length.
void set_flash(NativeBoard& self, const nb::bytes& flash) {
  if (flash.size() != MemoryBoard::kFlashBytes) {
    throw std::invalid_argument("the flash holds " + std::to_string(MemoryBoard::kFlashBytes) +
                                " bytes");
  }
  std::memcpy(self.memory().flash.data(), flash.c_str(), flash.size());
}

// Sets the number of illegal transitions that each encoder's counter has seen, as bad wiring would.
void set_illegal(NativeBoard& self, const std::array<std::uint32_t, heli::kAxisCount>& count) {
  std::copy(count.begin(), count.end(), self.memory().encoders.illegal);
}

// Hash, major and minor version of the link, and version of the firmware.
using Identity = std::tuple<std::uint32_t, int, int, std::string>;

// The firmware's version becomes text: "major.minor.patch".
Identity identity(std::uint32_t hash, int major, int minor, int firmware_major, int firmware_minor,
                  int firmware_patch) {
  return {hash, major, minor,
          std::to_string(firmware_major) + "." + std::to_string(firmware_minor) + "." +
              std::to_string(firmware_patch)};
}

// Asks a board for its versions; None if it does not answer within `max_ms` of its time.
std::optional<Identity> greet(SimBoard& board, std::uint32_t max_ms) {
  const auto welcome = heli_sim::greet(board, max_ms);
  if (!welcome) return std::nullopt;
  return identity(welcome->link_hash, welcome->link_major, welcome->link_minor,
                  welcome->firmware_major, welcome->firmware_minor, welcome->firmware_patch);
}

}  // namespace

void bind_board(nb::module_& module) {
  nb::class_<SimBoard>(module, "SimBoard", "A board that a world can fly.")
      .def(
          "reset", [](SimBoard& self) { self.reset(heli::link::Reset::user); },
          "Pulse the reset line, as a rising DTR does.")
      .def(
          "power_cycle", [](SimBoard& self) { self.reset(heli::link::Reset::power_up); },
          "Switch the supply off and on.")
      .def("erase", &SimBoard::erase, "Erase the flash, as 1200 baud does.")
      .def("set_stop", &SimBoard::set_stop, "pressed"_a)
      .def_prop_ro("in_reset", &SimBoard::in_reset)
      .def_prop_ro("boots", &SimBoard::boots);

  nb::class_<NativeBoard, SimBoard>(module, "NativeBoard",
                                    "The flight code compiled for this machine.")
      .def(nb::init<const std::string&, bool, std::uint64_t>(), "flash_file"_a = "",
           "from_edges"_a = false, "boot_seed"_a = 1)
      .def_prop_ro("counts",
                   [](NativeBoard& self) {
                     const std::int32_t* count = self.memory().encoders.count;
                     return std::array<std::int32_t, 3>{count[0], count[1], count[2]};
                   })
      .def_prop_ro("rx_overflow", [](NativeBoard& self) { return self.memory().rx_overflow; })
      .def_prop_rw("flash", &flash_bytes, &set_flash)
      .def_prop_rw(
          "encoder_illegal",
          [](NativeBoard& self) {
            const std::uint32_t* illegal = self.memory().encoders.illegal;
            return std::array<std::uint32_t, 3>{illegal[0], illegal[1], illegal[2]};
          },
          &set_illegal);

  module.def("greet", &greet, "board"_a, "max_ms"_a = 100,
             "Ask a board for its versions: (link hash, major, minor, firmware), or None.");
  module.def(
      "identity",
      [] {
        using namespace heli::link;
        return identity(kLinkHash, kLinkMajor, kLinkMinor, kFirmwareMajor, kFirmwareMinor,
                        kFirmwarePatch);
      },
      "What greet() says of a board with this flight code.");
}
