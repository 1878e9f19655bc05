// The interrupt of the control tick, every link::kTick_us.
#pragma once

#include "core.hpp"

namespace heli::due::tick_timer {

void start();

// In the interrupt, first.
void acknowledge();

// In the interrupt, last: the time from when this tick was due until now. It is late if it ends
// after the next one was due, or if ticks before it were missed.
TickTiming timing();

}  // namespace heli::due::tick_timer
