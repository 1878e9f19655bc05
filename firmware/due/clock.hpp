// Clock of the processor and of every peripheral.
#pragma once

#include <cstdint>

namespace heli::due::clock {

inline constexpr std::uint32_t kMck_Hz = 84000000;

// From the 4 MHz that the chip starts on to 84 MHz from the crystal. False when the crystal or the
// PLL does not start in time; the chip then still runs, on the last clock that worked.
bool start();

}  // namespace heli::due::clock
