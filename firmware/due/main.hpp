// The entry point after the reset handler, and the idle loop's sign of life.
#pragma once

namespace heli::due {

// Called by the reset handler, with memory initialised.
[[noreturn]] void run();

// From the idle loop, during a step that takes long: restarts the watchdog's deadline.
void kick_watchdog();

}  // namespace heli::due
