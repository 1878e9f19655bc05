// Priorities of the interrupts; a smaller number is more urgent.
#pragma once

namespace heli::due {

// An edge that waits for the tick is an edge lost.
inline constexpr unsigned kEncoderPriority = 0;
inline constexpr unsigned kTickPriority = 8;

}  // namespace heli::due
