// System control space: SysTick, NVIC, SCB and the few debug registers that programs use.
#pragma once

#include <cstdint>

#include "bus/bus.hpp"
#include "bus/scheduler.hpp"
#include "cpu/cpu.hpp"
#include "cpu/exceptions.hpp"

namespace due_emulator {

class SystemControl final : public PrivateBus, public EventSink {
 public:
  SystemControl(Cpu& cpu, Exceptions& exceptions, Scheduler& scheduler, Diagnostics& diagnostics);

  void reset();
  // Set by a write to AIRCR; the owner carries it out after the instruction.
  bool reset_requested = false;

  // Called by the bus for addresses from 0xE0000000 on; `size` is 1, 2 or 4 bytes.
  std::uint32_t read_private(std::uint32_t address, std::uint32_t size) override;
  void write_private(std::uint32_t address, std::uint32_t value, std::uint32_t size) override;
  void event(std::uint64_t now) override;

 private:
  std::uint32_t read_word(std::uint32_t address);
  void write_word(std::uint32_t address, std::uint32_t value);
  std::uint32_t read_nvic(std::uint32_t offset) const;
  void write_nvic(std::uint32_t offset, std::uint32_t value);
  std::uint32_t read_priorities(std::uint32_t first) const;
  void write_priorities(std::uint32_t first, std::uint32_t value);
  std::uint32_t icsr() const;
  void write_icsr(std::uint32_t value);
  void write_aircr(std::uint32_t value);
  std::uint32_t shcsr() const;
  void write_shcsr(std::uint32_t value);
  void unmodelled(std::uint32_t address, const char* verb);

  std::uint32_t systick_value() const;
  // Cycles from one zero of the counter to the next.
  std::uint64_t systick_period() const {
    return std::uint64_t{systick_reload_ + 1} * systick_step();
  }
  // Cycles per count: SYST_CSR.CLKSOURCE (bit 2) chooses MCK, otherwise MCK / 8.
  std::uint64_t systick_step() const { return (systick_control_ & 4U) != 0 ? 1 : 8; }
  void catch_up_systick();
  void start_systick();
  void plan_systick();

  Cpu& cpu_;
  Exceptions& exceptions_;
  Scheduler& scheduler_;
  Diagnostics& diagnostics_;
  Scheduler::Id id_;

  std::uint32_t systick_control_ = 0;  // SYST_CSR
  std::uint32_t systick_reload_ = 0;   // SYST_RVR
  // While running, the counter next becomes 0 at this cycle.
  std::uint64_t systick_zero_ = 0;
  std::uint32_t systick_stopped_value_ = 0;  // SYST_CVR while SysTick is off
  std::uint32_t demcr_ = 0;
  std::uint32_t dwt_control_ = 0;   // DWT_CTRL.CYCCNTENA
  std::uint64_t cyccnt_start_ = 0;  // cycle at which DWT_CYCCNT was 0, while it counts
  std::uint32_t cyccnt_held_ = 0;   // DWT_CYCCNT while it does not count
};

}  // namespace due_emulator
