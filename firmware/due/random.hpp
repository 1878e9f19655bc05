// Random bits from the chip's own noise.
#pragma once

#include <cstdint>

namespace heli::due::random {

// Returns 32 random bits; waits for 84 cycles. Before the tick starts.
std::uint32_t bits();

}  // namespace heli::due::random
