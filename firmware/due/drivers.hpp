// The drivers of the Due: start, clock, encoders, flash, serial port, random bits, faults,
// watchdog, tick.
#pragma once

#include <cstddef>
#include <cstdint>

#include "board.hpp"

// Declared, not included: a proof includes this header with registers that are variables.
namespace heli {
struct TickTiming;
}

// Functions that the vector table contains.
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

// Priorities of the interrupts; a smaller number is more urgent.
namespace heli::due {

// An edge that waits for the tick is an edge lost.
inline constexpr unsigned kEncoderPriority = 0;
inline constexpr unsigned kTickPriority = 8;

// The entry point after the reset handler, and the idle loop's sign of life.

// Called by the reset handler, with memory initialised.
[[noreturn]] void run();

// From the idle loop, during a step that takes long: restarts the watchdog's deadline.
void kick_watchdog();

}  // namespace heli::due

// The stack's unused part is filled with a known word ("paint"). A debugger or an emulator can then
// see how much of it was used, and the tick detects an overflow.
namespace heli::due::stack {

inline constexpr std::uint32_t kPaint = 0xA5A5A5A5;

// False after an overflow. The chip does not stop one: SRAM0 is mirrored below its start, so the
// stack would go on into the end of that bank, which is unused, and then into the variables.
inline bool intact() {
  const volatile std::uint32_t* lowest = __stack_bottom;
  return *lowest == kPaint;
}

}  // namespace heli::due::stack

// Clock of the processor and of every peripheral.
namespace heli::due::clock {

inline constexpr std::uint32_t kMck_Hz = 84000000;

// From the 4 MHz that the chip starts on to 84 MHz from the crystal. False when the crystal or the
// PLL does not start in time; the chip then still runs, on the last clock that worked.
bool start();

}  // namespace heli::due::clock

// Three incremental encoders: elevation and pitch in hardware decoders, travel by interrupt.
namespace heli::due::encoders {

void start();

// Control tick only: it counts the decoders' errors since the call before, and gives travel's
// interrupt the edges that it may serve until the next.
EncoderReading read();

}  // namespace heli::due::encoders

// The parameter pages: the last four of the flash, in the bank that holds no code.
namespace heli::due::flash {

inline constexpr std::size_t kPageBytes = 256;

// For both: `page` from 0 to 3; `count` is a multiple of 4 and at most kPageBytes.
void read_page(std::size_t page, std::uint8_t* to, std::size_t count);

// Erases the page and writes `count` bytes. Waits about 5 ms for the flash; interrupts are served
// meanwhile, because their code is in the other bank. False if the flash reports an error.
bool write_page(std::size_t page, const std::uint8_t* from, std::size_t count);

}  // namespace heli::due::flash

// UART0 to the ATmega16U2, both directions through the PDC. Idle loop only; nothing here waits.
namespace heli::due::uart {

void start();

// At every turn of the idle loop: hands the PDC what it may send or fill next.
void service();

// As Board's functions of these names.
std::size_t receive(std::uint8_t* to, std::size_t capacity);
std::size_t transmit_free();
void transmit(const std::uint8_t* bytes, std::size_t count);

}  // namespace heli::due::uart

// Random bits from the chip's own noise.
namespace heli::due::random {

// Returns 32 random bits; waits for 84 cycles. Before the tick starts.
std::uint32_t bits();

}  // namespace heli::due::random

// Handles faults of the processor, and keeps a record of them for after the reset.
namespace heli::due::faults {

// Once, early after every reset: why it came. Uses up the record of a fault.
BootReport read_boot_report();

// For errors after which nothing can continue: bridges off, recorded as a hard fault, reset.
[[noreturn]] void give_up();

}  // namespace heli::due::faults

// Resets the chip unless both the control tick and the idle loop keep running.
namespace heli::due::watchdog {

// Early in the start, once: the mode register takes one write after a reset.
void start();

// Idle loop, at every turn. `ticks` counts the control ticks.
void check_in(std::uint32_t ticks);

}  // namespace heli::due::watchdog

// The interrupt of the control tick, every link::kTick_us.
namespace heli::due::tick_timer {

void start();

// In the interrupt, first.
void acknowledge();

// In the interrupt, last: the time from when this tick was due until now. It is late if it ends
// after the next one was due, or if ticks before it were missed.
TickTiming timing();

}  // namespace heli::due::tick_timer
