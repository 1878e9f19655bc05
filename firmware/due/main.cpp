// Start of the board, its control tick and its idle loop.
#include <atomic>
#include <cstdint>

#include "cortex_m3.hpp"
#include "drivers.hpp"
#include "due_board.hpp"
#include "flight_code.hpp"
#include "motors.hpp"

namespace heli::due {
namespace {

Core* flight_core;
TickTiming last_tick;
std::atomic<std::uint32_t> ticks;

// Sleeps until the next interrupt, unless a tick has come since the counter was `seen`: the idle
// work after that tick would be late by a millisecond.
void sleep_unless_ticked(std::uint32_t seen) {
  mask_interrupts();
  if (ticks.load(std::memory_order_relaxed) == seen) wait_for_interrupt();
  unmask_interrupts();
}

}  // namespace

void kick_watchdog() { watchdog::check_in(ticks.load(std::memory_order_relaxed)); }

// Starts the drivers and the flight code, then runs the idle loop for ever.
[[noreturn]] void run() {
  const BootReport boot = faults::read_boot_report();
  if (!clock::start()) faults::give_up();
  motors::start();
  encoders::start();
  uart::start();

  static DueBoard board(boot);
  static FlightCode code(board);
  code.core.start();
  flight_core = &code.core;
  tick_timer::start();

  for (;;) {
    const std::uint32_t seen = ticks.load(std::memory_order_relaxed);
    code.core.poll();
    uart::service();
    watchdog::check_in(seen);
    sleep_unless_ticked(seen);
  }
}

}  // namespace heli::due

// The control tick, once per millisecond.
extern "C" void tick_interrupt() {
  using namespace heli::due;
  if (!stack::intact()) faults::give_up();
  tick_timer::acknowledge();
  flight_core->tick(last_tick);
  ticks.store(ticks.load(std::memory_order_relaxed) + 1U, std::memory_order_relaxed);
  last_tick = tick_timer::timing();
}
