#include "bus/diagnostics.hpp"
#include "python/bindings.hpp"

namespace nb = nanobind;

NB_MODULE(_due, module) {
  // Has the class that DueBoard is derived from.
  nb::module_::import_("heli_sim._native");
  module.doc() = "The emulated Arduino Due.";
  nb::exception<heli_due::Stop>(module, "Stop");
  bind_core(module);
  bind_due(module);
  bind_board(module);
}
