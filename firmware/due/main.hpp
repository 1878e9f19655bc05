// What the reset handler goes on with, and what takes the idle loop's time tells it.
#pragma once

namespace heli::due {

[[noreturn]] void run();

// Idle loop: it takes long, and lives.
void still_idle();

}  // namespace heli::due
