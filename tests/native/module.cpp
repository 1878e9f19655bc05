#include "bindings.hpp"

NB_MODULE(heli_test_native, module) {
  module.doc() = "Pieces of the flight code and of the simulated world, for tests.";
  bind_control(module);
  bind_flight(module);
  bind_law(module);
  bind_link(module);
  bind_plant(module);
  bind_proofs(module);
}
