// Power management controller (section 28): oscillators, PLLs, master clock, peripheral clocks.
#pragma once

#include "chip/peripheral.hpp"

namespace due_emulator {

class Pmc final : public Peripheral {
 public:
  explicit Pmc(System& system);

  void reset() override;
  void clock_changed() override { plan(); }
  void event(std::uint64_t now) override;

 protected:
  std::uint32_t read(std::uint32_t offset) override;
  void write(std::uint32_t offset, std::uint32_t value) override;
  bool write_protected() const override { return (protect_ & 1U) != 0; }

 private:
  void write_main_oscillator(std::uint32_t value);
  void write_plla(std::uint32_t value);
  void write_upll(std::uint32_t value);
  void write_system_clocks(std::uint32_t offset, std::uint32_t value);
  void write_master_clock(std::uint32_t value);
  void write_peripheral(std::uint32_t offset, std::uint32_t value);
  std::uint32_t main_Hz() const;
  std::uint32_t plla_Hz() const;
  std::uint32_t master_Hz(std::uint32_t mckr) const;
  void apply_master_clock();
  void settle();
  void plan();

  Scheduler::Id id_;
  std::uint32_t main_oscillator_ = 1;  // CKGR_MOR
  std::uint32_t plla_ = 0x3F00;        // CKGR_PLLAR
  std::uint32_t upll_ = 0;             // CKGR_UCKR
  std::uint32_t usb_ = 0;              // PMC_USB
  std::uint32_t system_clocks_ = 1;    // SCSR
  std::uint32_t master_ = 1;           // PMC_MCKR
  std::uint32_t status_ = 0;           // PMC_SR
  std::uint32_t protect_ = 0;          // PMC_WPMR.WPEN
  // Board times at which PMC_SR will report the crystal, the PLLs and the master clock as ready; 0:
  // nothing is starting.
  BoardTime crystal_ready_ = 0;
  BoardTime plla_ready_ = 0;
  BoardTime upll_ready_ = 0;
  BoardTime master_ready_ = 0;
  // Board times at which crystal and PLLs are really stable. PMC_SR can report them earlier, if a
  // program sets its start-up counters too short.
  BoardTime crystal_steady_ = 0;
  BoardTime plla_steady_ = 0;
  BoardTime upll_steady_ = 0;
};

}  // namespace due_emulator
