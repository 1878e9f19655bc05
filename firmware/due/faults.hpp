// What happens when the processor faults, and what is known of it after the reset that follows.
#pragma once

#include "board.hpp"

namespace heli::due::faults {

// Once, early after every reset: why it came. Uses up the record of a fault.
BootReport read_boot_report();

// For what cannot be gone on with: bridges off, recorded as a hard fault, reset.
[[noreturn]] void give_up();

}  // namespace heli::due::faults
