// Handles faults of the processor, and keeps a record of them for after the reset.
#pragma once

#include "board.hpp"

namespace heli::due::faults {

// Once, early after every reset: why it came. Uses up the record of a fault.
BootReport read_boot_report();

// For errors after which nothing can continue: bridges off, recorded as a hard fault, reset.
[[noreturn]] void give_up();

}  // namespace heli::due::faults
