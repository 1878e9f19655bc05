// The bare processor with flash and SRAM, for tests against other implementations of ARMv7-M.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include <cstring>
#include <memory>
#include <stdexcept>

#include "chip/system.hpp"
#include "cpu/scs.hpp"

namespace nb = nanobind;
using namespace due_emulator;

namespace {

// Processor, bus and memories; everything else of the chip is absent, and checks are lenient.
class BareCore {
 public:
  BareCore() : scs_(system_.cpu, system_.exceptions, system_.scheduler, system_.diagnostics) {
    system_.bus.connect(&system_.cpu, &scs_, nullptr);
    system_.exceptions.reset();
    system_.diagnostics.set_all_strict(false);
    system_.cpu.vtor = kFlashBase;
  }

  // Registers as after reset; the vector table is at the beginning of the flash.
  void reset() {
    system_.exceptions.reset();
    scs_.reset();
    system_.cpu.reset();
    system_.cpu.vtor = kFlashBase;
  }

  // Writes flash or SRAM, and forgets all decoded code.
  void write(std::uint32_t address, nb::bytes data) {
    const auto size = static_cast<std::uint32_t>(data.size());
    std::uint8_t* to = place(address, size);
    std::memcpy(to, data.c_str(), size);
    system_.memory.forget_flash_code();
    system_.memory.windows[Memory::kSram].forget_all();
    system_.memory.windows[Memory::kSram0].forget_all();
  }

  nb::bytes read(std::uint32_t address, std::uint32_t size) {
    return nb::bytes(reinterpret_cast<const char*>(place(address, size)), size);
  }

  // Runs up to `most` instructions and returns r0 to r12, SP, LR, PC and xPSR in front of each
  // instruction until PC is `stop`, and once more at the end. Instructions that an IT block skips
  // have no row, as in unicorn's code hook.
  nb::ndarray<nb::numpy, std::uint32_t, nb::ndim<2>> trace(std::uint32_t stop, std::size_t most) {
    constexpr std::size_t kColumns = 17;
    auto rows = std::make_unique<std::uint32_t[]>((most + 1) * kColumns);
    std::size_t count = 0;
    for (;;) {
      const bool at_stop = system_.cpu.pc() == stop;
      if (!at_stop && system_.cpu.next_is_skipped()) {
        system_.cpu.step(kNever - 1);
        continue;
      }
      std::uint32_t* row = rows.get() + count * kColumns;
      for (unsigned reg = 0; reg < 16; ++reg) row[reg] = system_.cpu.reg(reg);
      row[16] = system_.cpu.xpsr();
      if (at_stop || ++count > most) break;
      system_.cpu.step(kNever - 1);
    }
    if (count <= most) ++count;
    std::uint32_t* data = rows.release();
    nb::capsule owner(data, [](void* p) noexcept { delete[] static_cast<std::uint32_t*>(p); });
    return {data, {count, kColumns}, owner};
  }

  Cpu& cpu() { return system_.cpu; }
  Exceptions& exceptions() { return system_.exceptions; }

 private:
  // The bytes of flash or SRAM at an address.
  std::uint8_t* place(std::uint32_t address, std::uint32_t size) {
    if (address - kFlashBase < kFlashSize && size <= kFlashSize - (address - kFlashBase)) {
      return system_.memory.flash.data() + (address - kFlashBase);
    }
    if (address - kRamBase < kRamSize && size <= kRamSize - (address - kRamBase)) {
      return system_.memory.ram.data() + (address - kRamBase);
    }
    throw std::invalid_argument("no flash or SRAM of that size at " + hex(address));
  }

  System system_;
  SystemControl scs_;
};

}  // namespace

void bind_core(nb::module_& module) {
  nb::class_<BareCore>(module, "BareCore", "Cortex-M3 with flash and SRAM, without peripherals.")
      .def(nb::init<>())
      .def("reset", &BareCore::reset)
      .def("write", &BareCore::write, nb::arg("address"), nb::arg("data"))
      .def("read", &BareCore::read, nb::arg("address"), nb::arg("size"))
      .def("trace", &BareCore::trace, nb::arg("stop"), nb::arg("most"))
      .def(
          "run", [](BareCore& core, std::uint64_t until) { core.cpu().run(until); },
          nb::arg("until"))
      .def("reg", [](BareCore& core, unsigned index) { return core.cpu().reg(index); })
      .def("set_reg", [](BareCore& core, unsigned index,
                         std::uint32_t value) { core.cpu().set_reg(index, value); })
      .def("set_apsr", [](BareCore& core, std::uint32_t value) { core.cpu().set_apsr(value); })
      .def("pend",
           [](BareCore& core, unsigned number) {
             core.exceptions().pend(static_cast<std::uint8_t>(number));
           })
      .def_prop_ro("xpsr", [](BareCore& core) { return core.cpu().xpsr(); })
      .def_prop_ro("cfsr", [](BareCore& core) { return core.cpu().cfsr; })
      .def_prop_ro("cycles", [](BareCore& core) { return core.cpu().cycles(); })
      .def_prop_ro("instructions", [](BareCore& core) { return core.cpu().instructions(); });
}
