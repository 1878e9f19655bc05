// The Python module of the simulated world.
#include "bindings.hpp"

NB_MODULE(_native, module) {
  module.doc() = "The flight code compiled for this machine, and the world it flies in.";
  bind_board(module);
  bind_world(module);
}
