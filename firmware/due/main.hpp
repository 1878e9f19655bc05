// What the reset handler goes on with.
#pragma once

namespace heli::due {

[[noreturn]] void run();

}  // namespace heli::due
