// The small blocks of the backup area and the system controller: WDT, RSTC, GPBR, CHIPID.
#pragma once

#include <array>

#include "chip/peripheral.hpp"

namespace due_emulator {

// Watchdog (section 15): 12 bits downwards by the slow clock / 128, with a window.
class Wdt final : public Peripheral {
 public:
  explicit Wdt(System& system);
  void reset() override;
  void clock_changed() override { plan(); }
  void event(std::uint64_t now) override;
  // Restarts by WDT_CR since the model was made.
  std::uint64_t restarts() const { return restarts_; }

 protected:
  std::uint32_t read(std::uint32_t offset) override;
  void write(std::uint32_t offset, std::uint32_t value) override;

 private:
  BoardTime passed() const;
  // WDT_MR.WDV, from which the counter runs down, and WDD, below which it may be restarted.
  std::uint32_t value() const { return mode_ & 0xFFFU; }
  std::uint32_t window() const { return (mode_ >> 16) & 0xFFFU; }
  void restart();
  void fail(std::uint32_t error);
  void plan();

  Scheduler::Id id_;
  std::uint32_t mode_ = 0;  // WDT_MR
  bool written_ = false;    // after the last reset
  std::uint64_t restarts_ = 0;
  std::uint32_t status_ = 0;
  BoardTime start_ = 0;               // when the counter was loaded
  std::uint64_t sleep_at_start_ = 0;  // cycles that the processor had slept by then
};

// Reset controller (section 14).
class Rstc final : public Peripheral {
 public:
  explicit Rstc(System& system);
  void reset() override {}
  // `type` of the reset that is over.
  void note(ResetType type);
  void set_nrst(bool low);
  bool nrst_low() const { return nrst_low_; }

 protected:
  std::uint32_t read(std::uint32_t offset) override;
  void write(std::uint32_t offset, std::uint32_t value) override;

 private:
  std::uint32_t mode_ = 1;
  ResetType type_ = ResetType::kGeneral;
  bool user_seen_ = false;  // RSTC_SR.URSTS
  bool nrst_low_ = false;
};

// Eight words that survive every reset but not the loss of power (section 17).
class Gpbr final : public Peripheral {
 public:
  explicit Gpbr(System& system);
  void reset() override {}
  void power_lost() { words_.fill(0); }

 protected:
  std::uint32_t read(std::uint32_t offset) override { return words_[offset / 4]; }
  void write(std::uint32_t offset, std::uint32_t value) override { words_[offset / 4] = value; }

 private:
  std::array<std::uint32_t, 8> words_{};
};

// Chip identifier: it names the SAM3X8E.
class ChipId final : public Peripheral {
 public:
  explicit ChipId(System& system);
  void reset() override {}

 protected:
  std::uint32_t read(std::uint32_t offset) override { return offset == 0 ? 0x285E0A60U : 0U; }
  void write(std::uint32_t, std::uint32_t) override {}
};

}  // namespace due_emulator
