#include "bindings.hpp"

NB_MODULE(_native, module) {
  module.doc() = "The flight code compiled for this machine, and the world it flies in.";
  bind_world(module);
#ifdef HELI_HAVE_BIND_LINK
  bind_link(module);
#endif
#ifdef HELI_HAVE_BIND_CONTROL
  bind_control(module);
#endif
}
