// The parameter pages: the last four of the flash, in the bank that holds no code.
#pragma once

#include <cstddef>
#include <cstdint>

namespace heli::due::flash {

inline constexpr std::size_t kPageBytes = 256;

// For both: `page` from 0 to 3; `count` is a multiple of 4 and at most kPageBytes.
void read_page(std::size_t page, std::uint8_t* to, std::size_t count);

// Erases the page and writes `count` bytes. Waits about 5 ms for the flash; interrupts are served
// meanwhile, because their code is in the other bank. False if the flash reports an error.
bool write_page(std::size_t page, const std::uint8_t* from, std::size_t count);

}  // namespace heli::due::flash
