// What the peripherals of the chip share.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "bus/bus.hpp"
#include "bus/clock.hpp"
#include "bus/diagnostics.hpp"
#include "bus/memory.hpp"
#include "bus/scheduler.hpp"
#include "cpu/cpu.hpp"
#include "cpu/exceptions.hpp"

namespace due_emulator {

class Peripheral;

// Peripheral identifiers, which are also the interrupt numbers (datasheet, section 9.1).
namespace id {
inline constexpr int kWdt = 4;
inline constexpr int kEfc0 = 6;
inline constexpr int kEfc1 = 7;
inline constexpr int kUart = 8;
inline constexpr int kPioA = 11;
inline constexpr int kTc0 = 27;
inline constexpr int kPwm = 36;
inline constexpr int kAdc = 37;
inline constexpr int kDacc = 38;
inline constexpr int kUotghs = 40;
inline constexpr int kTrng = 41;
}  // namespace id

// RSTC_SR.RSTTYP
enum class ResetType : std::uint8_t {
  kGeneral = 0,
  kBackup = 1,
  kWatchdog = 2,
  kSoftware = 3,
  kUser = 4
};

// Fastest master clock at which the flash can be read with `wait_states` (vendor's header for the
// SAM3X8E, CHIP_FREQ_FWS_0 to _4, at 1.8 V).
constexpr std::uint32_t flash_limit_Hz(std::uint32_t wait_states) {
  constexpr std::uint32_t kLimits[] = {19000000, 50000000, 64000000, 80000000};
  return wait_states < 4 ? kLimits[wait_states] : 90000000;
}

// Processor, memories, bus, events and clock, and what the peripherals know of each other.
struct System {
  Memory memory;
  Diagnostics diagnostics;
  Scheduler scheduler;
  Exceptions exceptions;
  Clock clock;
  Bus bus{memory, diagnostics};
  Cpu cpu{memory, bus, scheduler, exceptions};
  std::vector<Peripheral*> peripherals;

  // PMC_PCSR0 and PCSR1.
  std::uint64_t peripheral_clocks = 0;
  // The RC oscillator of the slow clock: 20 to 44 kHz over parts and temperature.
  std::uint32_t slow_Hz = 32000;
  // UPLL is locked: the clock of the USB transceiver.
  bool upll_locked = false;
  // EEFC_FMR.FWS of both flash planes.
  std::array<std::uint32_t, 2> flash_wait_states{};
  // A reset was requested; the chip carries it out after the running instruction.
  bool reset_wanted = false;
  bool processor_only = false;
  ResetType reset_type = ResetType::kGeneral;

  // Time in cycles of MCK, and in board time.
  std::uint64_t now() const { return cpu.cycles(); }
  BoardTime board_now() const { return clock.time_at(cpu.cycles()); }
  // Whether the PMC clocks a peripheral.
  bool clocked(int identifier) const {
    return ((peripheral_clocks >> static_cast<unsigned>(identifier)) & 1U) != 0;
  }
  void set_irq(int identifier, bool high) {
    exceptions.set_line(static_cast<std::uint8_t>(identifier), high);
  }
  // Asks for a reset; the chip carries it out as soon as the running instruction ends.
  void request_reset(ResetType type, bool only_processor = false) {
    reset_wanted = true;
    processor_only = only_processor;
    reset_type = type;
    cpu.interrupt_run();
  }
  void change_mck(std::uint32_t mck_Hz);
  // Board time of `count` periods of the slow clock.
  BoardTime slow_periods(std::uint64_t count) const {
    return count * kFull_Hz * kOneCycle / slow_Hz;
  }
};

}  // namespace due_emulator
