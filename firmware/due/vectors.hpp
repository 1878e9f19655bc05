// Functions that the vector table contains.
#pragma once

#include <cstdint>

extern "C" {

[[noreturn]] void reset_handler();
void encoder_interrupt();
void tick_interrupt();

// Every vector that is not one of the above: faults and interrupts that nobody expects.
[[noreturn]] void fault_entry();
[[noreturn]] void fault_handler(const std::uint32_t* frame);

// From the linker script.
extern std::uint32_t __stack_bottom[];
extern std::uint32_t __stack_top[];

}  // extern "C"
