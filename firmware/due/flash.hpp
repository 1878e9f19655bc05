// The parameter pages: the last four of the flash, in the bank that holds no code.
#pragma once

#include <cstddef>
#include <cstdint>

namespace heli::due::flash {

inline constexpr std::size_t kPageBytes = 256;

// `count` is a multiple of 4 and at most a page, in both.
void read_page(std::size_t page, std::uint8_t* to, std::size_t count);

// Waits for the flash, about 5 ms; interrupts go on meanwhile, because they run from the other
// bank.
bool write_page(std::size_t page, const std::uint8_t* from, std::size_t count);

}  // namespace heli::due::flash
