// The stack's unused part is painted, so that a debugger or an emulator sees how deep it went, and
// so that the tick sees when it went too deep.
#pragma once

#include <cstdint>

#include "vectors.hpp"

namespace heli::due::stack {

inline constexpr std::uint32_t kPaint = 0xA5A5A5A5;

// On the chip nothing stops a stack that overflows: SRAM0 repeats below its own start, so it goes
// on into the end of that bank, which nobody uses, and then into the variables.
inline bool intact() {
  const volatile std::uint32_t* lowest = __stack_bottom;
  return *lowest == kPaint;
}

}  // namespace heli::due::stack
