// USB port (section 40) with no cable in it: its clocks, its switches and its interrupt masks,
// which is what a program touches that opens the port and then uses another. Endpoints, pipes and
// DMA are not modelled.
#pragma once

#include "chip/peripheral.hpp"

namespace due_emulator {

class Uotghs final : public Peripheral {
 public:
  explicit Uotghs(System& system);

  void reset() override;

 protected:
  std::uint32_t read(std::uint32_t offset) override;
  void write(std::uint32_t offset, std::uint32_t value) override;

 private:
  std::uint32_t control_ = 0;     // CTRL
  std::uint32_t device_ = 0;      // DEVCTRL
  std::uint32_t interrupts_ = 0;  // DEVIMR
  std::uint32_t endpoints_ = 0;   // DEVEPT
};

}  // namespace due_emulator
