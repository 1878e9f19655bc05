// Resets the chip unless both the control tick and the idle loop keep running.
#pragma once

#include <cstdint>

namespace heli::due::watchdog {

// Early in the start, once: the mode register takes one write after a reset.
void start();

// Idle loop, at every turn. `ticks` counts the control ticks.
void check_in(std::uint32_t ticks);

}  // namespace heli::due::watchdog
