// The Python module of the emulator.
#include "bus/diagnostics.hpp"
#include "python/bindings.hpp"

namespace nb = nanobind;

NB_MODULE(_due, module) {
  module.doc() = "The emulated Arduino Due.";
  const nb::object errors = nb::module_::import_("due_emulator.errors");
  nb::exception<due_emulator::Stop>(module, "Stop", errors.attr("EmulatorError"));
  bind_core(module);
  bind_due(module);
}
