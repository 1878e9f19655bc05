// The parameter pages: the last ones of the flash, in the bank that holds no code.
#pragma once

#include <cstddef>
#include <cstdint>

namespace heli::due::flash {

void read_page(std::size_t page, std::uint8_t* to);

// Waits for the flash, about 5 ms; interrupts go on meanwhile, because they run from the other
// bank.
bool write_page(std::size_t page, const std::uint8_t* from);

}  // namespace heli::due::flash
