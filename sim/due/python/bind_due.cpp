// The board for Python: running, the USB side, pins and encoders, debugging, measurements.
#include <nanobind/nanobind.h>
#include <nanobind/stl/pair.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include <stdexcept>
#include <string>
#include <tuple>
#include <vector>

#include "board/due.hpp"
#include "bus/diagnostics.hpp"

namespace nb = nanobind;
using namespace due_emulator;

void bind_core(nb::module_& module);  // bind_core.cpp

namespace {

const std::uint8_t* bytes_of(const nb::bytes& data) {
  return reinterpret_cast<const std::uint8_t*>(data.c_str());
}

nb::bytes to_bytes(const std::vector<std::uint8_t>& data) {
  return nb::bytes(reinterpret_cast<const char*>(data.data()), data.size());
}

BoardTime from_us(double us) { return static_cast<BoardTime>(us * static_cast<double>(kOneUs)); }

// "PC21" to the number of the pin.
int pin_number(const std::string& name) {
  if (name.size() >= 3 && name[0] == 'P' && name[1] >= 'A' && name[1] <= 'D') {
    const int bit = std::atoi(name.c_str() + 2);
    if (bit >= 0 && bit < 32) return pin_of(name[1], bit);
  }
  throw std::invalid_argument("no pin is called " + name + "; write PA0 to PD31");
}

// "open", "pull-down" and so on to what is connected to a pin.
External external_of(const std::string& state) {
  if (state == "open") return External::kOpen;
  if (state == "pull-down") return External::kPullDown;
  if (state == "pull-up") return External::kPullUp;
  if (state == "low") return External::kLow;
  if (state == "high") return External::kHigh;
  throw std::invalid_argument("a pin can be open, pull-down, pull-up, low or high, not " + state);
}

// A check's name, as trouble_name() gives it, to its number.
Trouble trouble_of(const std::string& name) {
  for (int i = 0; i < kTroubleCount; ++i) {
    if (name == trouble_name(static_cast<Trouble>(i))) return static_cast<Trouble>(i);
  }
  throw std::invalid_argument("no check is called " + name);
}

const char* halt_name(Halt halt) {
  static constexpr const char* kNames[] = {"", "breakpoint", "hardfault", "lockup"};
  return kNames[static_cast<std::size_t>(halt)];
}

// Bytes of one access by a debugger: peripherals (from 0x40000000 on) are accessed in words, if
// address and size allow it.
std::uint32_t access_bytes(std::uint32_t address, std::size_t size) {
  return address >= 0x40000000 && address % 4 == 0 && size % 4 == 0 ? 4 : 1;
}

// Memory for a debugger, as bytes. What cannot be read gives zeros and no fault.
nb::bytes peek(Due& due, std::uint32_t address, std::uint32_t size) {
  System& system = due.chip.system;
  std::vector<std::uint8_t> data(size);
  const std::uint32_t step = access_bytes(address, size);
  for (std::uint32_t i = 0; i < size; i += step) {
    std::uint32_t value = 0;
    try {
      value = system.bus.read(address + i, step);
    } catch (const Fault&) {
    } catch (const Stop&) {
    }
    for (std::uint32_t k = 0; k < step; ++k) {
      data[i + k] = static_cast<std::uint8_t>(value >> (8 * k));
    }
  }
  return to_bytes(data);
}

// Writes memory for a debugger: flash directly, everything else by the bus.
void poke(Due& due, std::uint32_t address, const nb::bytes& data) {
  System& system = due.chip.system;
  const std::uint8_t* from = bytes_of(data);
  const std::uint32_t step = access_bytes(address, data.size());
  for (std::uint32_t i = 0; i < data.size(); i += step) {
    const std::uint32_t offset = address + i - kFlashBase;
    // Below the flash, the unsigned difference is larger than any offset.
    if (offset < kFlashSize) {
      system.memory.flash[offset] = from[i];
      system.cpu.flush_flash_code();
      continue;
    }
    std::uint32_t value = 0;
    for (std::uint32_t k = 0; k < step; ++k) {
      value |= std::uint32_t{from[i + k]} << (8 * k);
    }
    try {
      system.bus.write(address + i, value, step);
    } catch (const Fault&) {
      throw std::invalid_argument("nothing can be written at " + hex(address + i));
    }
  }
}

// Peripheral, its base address, register, its offset; readable, writable, modelled.
using RegisterRow =
    std::tuple<std::string, std::uint32_t, std::string, std::uint32_t, bool, bool, bool>;

// All registers of all peripherals, for a comparison with the chip's SVD file.
std::vector<RegisterRow> registers(Due& due) {
  std::vector<RegisterRow> rows;
  for (const Peripheral* peripheral : due.chip.system.peripherals) {
    for (const Register& reg : peripheral->registers()) {
      rows.emplace_back(peripheral->name(), peripheral->base(), reg.name, reg.offset,
                        (reg.access & access::kRead) != 0, (reg.access & access::kWrite) != 0,
                        (reg.access & access::kUnmodelled) == 0);
    }
  }
  return rows;
}

// Switches all peripheral clocks on or off, so that tests need no PMC.
void set_peripheral_clocks(Due& due, bool all) {
  due.chip.system.peripheral_clocks = all ? ~std::uint64_t{0} : 0;
}

// Power, time, resets and the checks of strict mode.
void bind_running(nb::class_<Due>& due) {
  due.def(nb::init<>())
      .def("power_on", &Due::power_on)
      .def("power_off", &Due::power_off)
      .def(
          "seed_random", [](Due& self, std::uint64_t seed) { self.chip.trng.seed(seed); },
          nb::arg("seed"), "What the random number generator gives from now on.")
      .def(
          "load",
          [](Due& self, std::uint32_t address, const nb::bytes& data) {
            self.load(address, bytes_of(data), data.size());
          },
          nb::arg("address"), nb::arg("data"))
      .def(
          "run_us", [](Due& self, double us) { self.run_for(from_us(us)); }, nb::arg("us"))
      .def(
          "run_until_us", [](Due& self, double us) { self.run_until(from_us(us)); }, nb::arg("us"))
      .def("step", [](Due& self) { self.chip.step(); })
      .def_prop_ro("now_us",
                   [](const Due& self) {
                     return static_cast<double>(self.now()) / static_cast<double>(kOneUs);
                   })
      .def_prop_ro("mck_Hz", [](const Due& self) { return self.chip.system.clock.mck_Hz(); })
      .def_prop_ro("in_rom", [](const Due& self) { return self.chip.in_rom(); })
      .def_prop_ro("held_in_reset", [](const Due& self) { return self.chip.system.cpu.held(); })
      .def_prop_ro("resets", [](const Due& self) { return self.chip.resets(); })
      .def_prop_ro("watchdog_restarts", [](const Due& self) { return self.chip.wdt.restarts(); })
      .def_prop_ro("last_reset",
                   [](const Due& self) {
                     static constexpr const char* kNames[] = {"general", "backup", "watchdog",
                                                              "software", "user"};
                     return kNames[static_cast<std::size_t>(self.chip.last_reset())];
                   })
      .def(
          "set_nrst", [](Due& self, bool low) { self.chip.set_nrst(low); }, nb::arg("low"))
      .def(
          "hold_processor", [](Due& self, bool held) { self.chip.system.cpu.hold(held); },
          nb::arg("held"))
      .def(
          "set_slow_clock",
          [](Due& self, std::uint32_t hz) {
            self.chip.system.slow_Hz = hz;
            self.chip.system.scheduler.clock_changed();
          },
          nb::arg("slow_Hz"))
      .def(
          "set_strict",
          [](Due& self, bool strict) { self.chip.system.diagnostics.set_all_strict(strict); },
          nb::arg("strict"))
      .def(
          "set_check",
          [](Due& self, const std::string& check, bool strict) {
            self.chip.system.diagnostics.set_strict(trouble_of(check), strict);
          },
          nb::arg("check"), nb::arg("strict"))
      .def("take_warnings", [](Due& self) { return self.chip.system.diagnostics.take_warnings(); });
}

// What is connected to the board: USB, encoders, pins, voltages; and the flash as a programmer sees
// it.
void bind_outside(nb::class_<Due>& due) {
  due.def(
         "usb_line_coding",
         [](Due& self, std::uint32_t baud) { self.bridge.set_line_coding(baud); }, nb::arg("baud"))
      .def(
          "usb_control_lines", [](Due& self, bool dtr) { self.bridge.set_control_lines(dtr); },
          nb::arg("dtr"))
      .def(
          "usb_write",
          [](Due& self, const nb::bytes& data) { self.bridge.write(bytes_of(data), data.size()); },
          nb::arg("data"))
      .def("usb_read", [](Due& self) { return to_bytes(self.bridge.read()); })
      .def(
          "usb_reading", [](Due& self, bool reading) { self.bridge.set_host_reading(reading); },
          nb::arg("reading"))
      .def_prop_ro("usb_lost", [](const Due& self) { return self.bridge.to_host_lost(); })
      .def_prop_ro("usb_waiting", [](const Due& self) { return self.bridge.to_board_waiting(); })
      .def_prop_ro("uart_overruns", [](const Due& self) { return self.chip.uart.overruns(); })
      .def(
          "attach_encoder",
          [](Due& self, const std::string& pin_a, const std::string& pin_b) {
            return self.attach_encoder(pin_number(pin_a), pin_number(pin_b));
          },
          nb::arg("pin_a"), nb::arg("pin_b"))
      .def("set_encoder", &Due::set_encoder, nb::arg("encoder"), nb::arg("count"))
      .def("encoder", &Due::encoder, nb::arg("encoder"))
      .def("glitch_encoder", &Due::glitch_encoder, nb::arg("encoder"))
      .def(
          "schedule_step",
          [](Due& self, int encoder, int direction, double when_us) {
            self.schedule_step(encoder, direction, from_us(when_us));
          },
          nb::arg("encoder"), nb::arg("direction"), nb::arg("when_us"))
      .def(
          "pin",
          [](const Due& self, const std::string& name) { return self.pin(pin_number(name)); },
          nb::arg("name"))
      .def(
          "set_pin",
          [](Due& self, const std::string& name, const std::string& state) {
            self.chip.pins.set_external(pin_number(name), external_of(state),
                                        self.chip.system.now());
          },
          nb::arg("name"), nb::arg("state"))
      .def(
          "set_analog",
          [](Due& self, int channel, double volts) {
            if (channel < 0 || channel >= Adc::kChannels) {
              throw std::invalid_argument("the converter has inputs 0 to 15");
            }
            self.chip.adc.set_input(channel, volts);
          },
          nb::arg("channel"), nb::arg("volts"))
      .def(
          "analog_out",
          [](const Due& self, int channel) {
            if (channel < 0 || channel >= Dacc::kChannels) {
              throw std::invalid_argument("there are outputs DAC0 and DAC1");
            }
            return self.chip.dacc.output_V(channel);
          },
          nb::arg("channel"))
      .def(
          "pin_duty",
          [](const Due& self, const std::string& name) { return self.pin_duty(pin_number(name)); },
          nb::arg("name"))
      .def(
          "pwm_high_cycles",
          [](Due& self, int channel, bool low_side) {
            return self.chip.pwm.high_cycles(channel, low_side);
          },
          nb::arg("channel"), nb::arg("low_side"))
      .def(
          "pwm_period_cycles",
          [](Due& self, int channel) { return self.chip.pwm.period_cycles(channel); },
          nb::arg("channel"))
      .def("flash", [](const Due& self) { return to_bytes(self.chip.system.memory.flash); })
      .def_prop_ro(
          "flash_writes",
          [](const Due& self) { return self.chip.efc0.writes() + self.chip.efc1.writes(); })
      .def_prop_ro(
          "flash_stores",
          [](const Due& self) { return self.chip.efc0.stores() + self.chip.efc1.stores(); })
      .def_prop_ro("flash_busy", [](const Due& self) { return self.chip.system.cpu.flash_busy; });
}

// Registers of the processor, memory, breakpoints and symbols.
void bind_debugging(nb::class_<Due>& due) {
  due.def_prop_ro("halt", [](const Due& self) { return halt_name(self.chip.system.cpu.halt()); })
      .def("resume", [](Due& self) { self.chip.system.cpu.clear_halt(); })
      .def(
          "stop_at_hardfault",
          [](Due& self, bool stop) { self.chip.system.cpu.stop_at_hardfault = stop; },
          nb::arg("stop"))
      .def(
          "reg",
          [](const Due& self, unsigned index) { return self.chip.system.cpu.reg(index & 15U); },
          nb::arg("index"))
      .def(
          "set_reg",
          [](Due& self, unsigned index, std::uint32_t value) {
            self.chip.system.cpu.set_reg(index & 15U, value);
          },
          nb::arg("index"), nb::arg("value"))
      .def_prop_rw(
          "xpsr", [](const Due& self) { return self.chip.system.cpu.xpsr(); },
          [](Due& self, std::uint32_t value) { self.chip.system.cpu.set_apsr(value); })
      .def_prop_ro("msp", [](const Due& self) { return self.chip.system.cpu.msp(); })
      .def_prop_ro("psp", [](const Due& self) { return self.chip.system.cpu.psp(); })
      .def_prop_ro("cfsr", [](const Due& self) { return self.chip.system.cpu.cfsr; })
      .def_prop_ro("hfsr", [](const Due& self) { return self.chip.system.cpu.hfsr; })
      .def_prop_ro("bfar", [](const Due& self) { return self.chip.system.cpu.bfar; })
      .def_prop_ro("instructions",
                   [](const Due& self) { return self.chip.system.cpu.instructions(); })
      .def_prop_ro("cycles", [](const Due& self) { return self.chip.system.cpu.cycles(); })
      .def_prop_ro("sleep_cycles",
                   [](const Due& self) { return self.chip.system.cpu.sleep_cycles(); })
      .def("peek", &peek, nb::arg("address"), nb::arg("size"))
      .def(
          "read_word",
          [](Due& self, std::uint32_t address) {
            try {
              return self.chip.system.bus.read(address, 4);
            } catch (const Fault&) {
              throw std::invalid_argument("nothing can be read at " + hex(address));
            }
          },
          nb::arg("address"))
      .def(
          "write_word",
          [](Due& self, std::uint32_t address, std::uint32_t value) {
            try {
              self.chip.system.bus.write(address, value, 4);
            } catch (const Fault&) {
              throw std::invalid_argument("nothing can be written at " + hex(address));
            }
          },
          nb::arg("address"), nb::arg("value"))
      .def("poke", &poke, nb::arg("address"), nb::arg("data"))
      .def(
          "add_breakpoint",
          [](Due& self, std::uint32_t address) { self.chip.system.cpu.add_breakpoint(address); },
          nb::arg("address"))
      .def(
          "remove_breakpoint",
          [](Due& self, std::uint32_t address) { self.chip.system.cpu.remove_breakpoint(address); },
          nb::arg("address"))
      .def(
          "add_symbol",
          [](Due& self, std::uint32_t address, std::uint32_t size, std::string name) {
            self.chip.system.diagnostics.symbols.add(address, size, std::move(name));
          },
          nb::arg("address"), nb::arg("size"), nb::arg("name"))
      .def(
          "describe",
          [](const Due& self, std::uint32_t address) {
            return self.chip.system.diagnostics.symbols.describe(address);
          },
          nb::arg("address"))
      .def("registers", &registers)
      .def("all_clocks_on", &set_peripheral_clocks, nb::arg("on"));
}

// Costs of functions (probes) and of exception handlers.
void bind_measuring(nb::module_& module, nb::class_<Due>& due) {
  nb::class_<ProbeStats>(module, "ProbeStats")
      .def_ro("count", &ProbeStats::count)
      .def_ro("instructions", &ProbeStats::instructions)
      .def_ro("max_instructions", &ProbeStats::max_instructions)
      .def_ro("last_instructions", &ProbeStats::last_instructions);
  nb::class_<ExceptionStats>(module, "ExceptionStats")
      .def_ro("count", &ExceptionStats::count)
      .def_ro("instructions", &ExceptionStats::instructions)
      .def_ro("max_instructions", &ExceptionStats::max_instructions)
      .def_ro("max_cycles", &ExceptionStats::max_cycles);
  due.def(
         "add_probe",
         [](Due& self, std::uint32_t address) { self.chip.system.cpu.add_probe(address); },
         nb::arg("address"))
      .def(
          "probe",
          [](const Due& self, std::uint32_t address) {
            return self.chip.system.cpu.probe(address);
          },
          nb::arg("address"))
      .def(
          "exception_stats",
          [](const Due& self, unsigned number) {
            if (number >= exc::kCount) throw std::invalid_argument("there are exceptions 0 to 60");
            return self.chip.system.cpu.stats(static_cast<std::uint8_t>(number));
          },
          nb::arg("number"))
      .def(
          "last_entry_cycle",
          [](const Due& self, unsigned number) {
            if (number >= exc::kCount) throw std::invalid_argument("there are exceptions 0 to 60");
            return self.chip.system.cpu.stats(static_cast<std::uint8_t>(number)).last_entry;
          },
          nb::arg("number"))
      .def("clear_stats", [](Due& self) { self.chip.system.cpu.clear_stats(); });
}

}  // namespace

NB_MODULE(_due, module) {
  module.doc() = "The emulated Arduino Due.";
  const nb::object errors = nb::module_::import_("due_emulator.errors");
  nb::exception<Stop>(module, "Stop", errors.attr("EmulatorError"));
  bind_core(module);
  nb::class_<Due> due(module, "Due", "The emulated Arduino Due.");
  bind_running(due);
  bind_outside(due);
  bind_debugging(due);
  bind_measuring(module, due);
}
