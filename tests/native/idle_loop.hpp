// Lets a test derive a controller's constants, which on a board only the core's idle loop can.
#pragma once

#include "control/controller.hpp"

namespace heli::control {

struct IdleLoopOfTests {
  static constexpr IdleLoop make() { return IdleLoop(nullptr); }
};

}  // namespace heli::control
