// Random bits from the chip's own noise.
#pragma once

#include <cstdint>

namespace heli::due::random {

// 32 of them, in 84 cycles.
std::uint32_t bits();

}  // namespace heli::due::random
