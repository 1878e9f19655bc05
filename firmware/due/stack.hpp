// The stack's unused part is filled with a known word ("paint"). A debugger or an emulator can then
// see how much of it was used, and the tick detects an overflow.
#pragma once

#include <cstdint>

#include "vectors.hpp"

namespace heli::due::stack {

inline constexpr std::uint32_t kPaint = 0xA5A5A5A5;

// False after an overflow. The chip does not stop one: SRAM0 is mirrored below its start, so the
// stack would go on into the end of that bank, which is unused, and then into the variables.
inline bool intact() {
  const volatile std::uint32_t* lowest = __stack_bottom;
  return *lowest == kPaint;
}

}  // namespace heli::due::stack
