// Vector table, and the steps from reset to main.
#include <cstddef>
#include <cstdint>

#include "cortex_m3.hpp"
#include "drivers.hpp"
#include "motors.hpp"

extern "C" {
extern std::uint32_t __data_load[];
extern std::uint32_t __data_start[];
extern std::uint32_t __data_end[];
extern std::uint32_t __bss_start[];
extern std::uint32_t __bss_end[];

// The compiler calls it instead of a pure virtual function.
[[noreturn]] void __cxa_pure_virtual() { heli::due::faults::give_up(); }
}

namespace heli::due {
namespace {

constexpr std::size_t kExceptions = 16;
constexpr std::size_t kInterrupts = 45;

using Handler = void (*)();

struct VectorTable {
  std::uint32_t* stack;
  Handler handlers[kExceptions + kInterrupts - 1];
};

constexpr VectorTable vector_table() {
  VectorTable table{};
  table.stack = __stack_top;
  for (Handler& handler : table.handlers) handler = fault_entry;
  // The first word is the stack pointer, so handler n of the array is exception n + 1.
  table.handlers[0] = reset_handler;
  table.handlers[kExceptions + ID_PIOD - 1] = encoder_interrupt;
  table.handlers[kExceptions + ID_TC3 - 1] = tick_interrupt;
  return table;
}

[[gnu::section(".vectors"), gnu::used]] constexpr VectorTable kVectors = vector_table();

std::uint32_t* stack_pointer() {
  std::uint32_t* pointer = nullptr;
  asm volatile("mov %0, sp" : "=r"(pointer));
  return pointer;
}

// Copies initial values to RAM, clears the other variables, paints the stack below its present end.
void initialise_memory() {
  const std::uint32_t* from = __data_load;
  for (std::uint32_t* to = __data_start; to != __data_end; ++to) *to = *from++;
  for (std::uint32_t* to = __bss_start; to != __bss_end; ++to) *to = 0;
  for (std::uint32_t* to = __stack_bottom; to != stack_pointer(); ++to) *to = stack::kPaint;
}

}  // namespace
}  // namespace heli::due

extern "C" [[gnu::noinline]] void reset_handler() {
  using namespace heli::due;
  // Motors off before everything else. No variable has its value before initialise_memory().
  motors::hold_off();
  watchdog::start();
  SCB->VTOR.write(static_cast<std::uint32_t>(reinterpret_cast<std::uintptr_t>(&kVectors)));
  SCB->CCR.write(CCR_STKALIGN | CCR_DIV_0_TRP | CCR_UNALIGN_TRP);
  initialise_memory();
  run();
}
