// Enhanced embedded flash controllers (section 18): wait states, page latches, programming.
//
// A plane that is being programmed can be neither read nor executed. Programming takes its time,
// and a reset or a loss of power in between leaves the page half done.
#pragma once

#include <array>

#include "chip/peripheral.hpp"

namespace due_emulator {

class FlashController;

// The two planes together, as the bus sees them.
class Flash final : public FlashPort {
 public:
  explicit Flash(System& system);

  void use(std::uint32_t offset) override;
  void latch(std::uint32_t offset, std::uint32_t value, std::uint32_t size) override;

  FlashController& plane(int index) { return *planes_[static_cast<std::size_t>(index)]; }
  void attach(int index, FlashController* plane) {
    planes_[static_cast<std::size_t>(index)] = plane;
  }
  void update_busy();
  // GPNVM bits: 0 security, 1 boot from flash, 2 flash plane order.
  std::uint32_t gpnvm = 0;

 private:
  FlashController& plane_at(std::uint32_t offset) { return plane(offset < kPlaneSize ? 0 : 1); }

  System& system_;
  std::array<FlashController*, 2> planes_{};
};

// One EEFC and its plane.
class FlashController final : public Peripheral {
 public:
  static constexpr std::uint32_t kPage = 256;
  static constexpr std::uint32_t kPages = kPlaneSize / kPage;
  static constexpr std::uint32_t kLockRegion = 16 * 1024;
  // Typical times; the datasheet gives 4.6 ms for a page with erase, 2.3 ms without.
  static constexpr BoardTime kWriteTime = 2300 * kOneUs;
  static constexpr BoardTime kEraseTime = 2300 * kOneUs;
  static constexpr BoardTime kEraseAllTime = 11500 * kOneUs;
  // Writing needs FWS = 6 whatever the clock, by the chip's errata.
  static constexpr std::uint32_t kWriteWaitStates = 6;

  FlashController(System& system, Flash& flash, int index);

  void reset() override;
  void clock_changed() override { plan(); }
  void event(std::uint64_t now) override;

  bool busy() const { return command_ != 0; }
  std::uint64_t ready_cycle() const { return system_.clock.cycle_at(end_); }
  void latch(std::uint32_t offset, std::uint32_t value);
  // Power or reset went away in the middle: leaves what was reached by now.
  void cut();
  void erase_all();
  std::uint64_t writes() const { return writes_; }
  // Stores of a program to the page latches, and commands.
  std::uint64_t stores() const { return stores_; }

 protected:
  std::uint32_t read(std::uint32_t offset) override;
  void write(std::uint32_t offset, std::uint32_t value) override;

 private:
  void set_wait_states(std::uint32_t count);
  void command(std::uint32_t value);
  void start(std::uint32_t code, std::uint32_t page, BoardTime erase, BoardTime write);
  void result(std::uint32_t word);
  // Changes the flash to what the running command has done after `passed`.
  void apply(BoardTime passed);
  void plan();
  void update_irq();
  void check_caller() const;
  std::uint8_t* page_bytes(std::uint32_t page) const;

  Flash& flash_;
  int index_;
  Scheduler::Id id_;
  std::uint32_t mode_ = 0;    // EEFC_FMR
  std::uint32_t errors_ = 0;  // EEFC_FSR: FCMDE, FLOCKE
  std::uint32_t locks_ = 0;   // one bit per region
  std::array<std::uint32_t, 16> results_{};
  std::uint32_t result_count_ = 0;
  std::uint32_t result_next_ = 0;
  std::array<std::uint8_t, kPage> latches_{};
  std::uint32_t command_ = 0;  // the one that runs, with kBusyMark; 0: none
  std::uint32_t page_ = 0;
  BoardTime begin_ = 0;
  BoardTime erase_ = 0;  // how long the erase takes, from begin_ on
  BoardTime end_ = 0;
  std::uint64_t writes_ = 0;
  std::uint64_t stores_ = 0;
};

}  // namespace due_emulator
