// The module of pieces for tests; each bind_*.cpp binds those of one room.
#include <nanobind/nanobind.h>

void bind_control(nanobind::module_& module);
void bind_flight(nanobind::module_& module);
void bind_law(nanobind::module_& module);
void bind_link(nanobind::module_& module);
void bind_plant(nanobind::module_& module);
void bind_proofs(nanobind::module_& module);

NB_MODULE(heli_test_native, module) {
  module.doc() = "Pieces of the flight code and of the simulated world, for tests.";
  bind_control(module);
  bind_flight(module);
  bind_law(module);
  bind_link(module);
  bind_plant(module);
  bind_proofs(module);
}
