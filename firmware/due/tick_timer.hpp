// The interrupt of the control tick, every link::kTick_us.
#pragma once

#include "core.hpp"

namespace heli::due::tick_timer {

void start();

// In the interrupt, first.
void acknowledge();

// In the interrupt, last: how long this tick took since it was due, and whether it ended after the
// next was due or came after others that nobody served.
TickTiming timing();

}  // namespace heli::due::tick_timer
