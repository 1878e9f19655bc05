// The SAM3X8E: processor, memories and peripherals, and what a reset does to them.
#pragma once

#include <array>
#include <cstdint>
#include <memory>

#include "chip/adc.hpp"
#include "chip/dacc.hpp"
#include "chip/eefc.hpp"
#include "chip/pins.hpp"
#include "chip/pio.hpp"
#include "chip/pmc.hpp"
#include "chip/pwm.hpp"
#include "chip/supply.hpp"
#include "chip/system.hpp"
#include "chip/tc.hpp"
#include "chip/trng.hpp"
#include "chip/uart.hpp"
#include "chip/uotghs.hpp"
#include "cpu/scs.hpp"

namespace due_emulator {

class Chip final : public EventSink {
 public:
  Chip();

  // Power comes up: SRAM and backup registers hold nothing, a program in flash starts.
  void power_on();
  // Power goes: what is being written to flash stays half done.
  void power_off();
  // Lets board time pass up to `until`; returns early when the processor halts.
  void run_until(BoardTime until);
  // One step of the processor, and the reset that it may have asked for.
  void step();
  // The NRST pin.
  void set_nrst(bool low);

  // Whether the processor is in the boot loader in ROM. That is not modelled: it does nothing.
  bool in_rom() const { return in_rom_; }
  bool powered() const { return powered_; }
  std::uint64_t resets() const { return resets_; }
  ResetType last_reset() const { return last_reset_; }

  void event(std::uint64_t now) override;

  System system;
  SystemControl scs;
  Pins pins;
  Flash flash;
  Pmc pmc;
  FlashController efc0;
  FlashController efc1;
  Wdt wdt;
  Rstc rstc;
  Gpbr gpbr;
  ChipId chipid;
  Pio pioa;
  Pio piob;
  Pio pioc;
  Pio piod;
  Tc tc0;
  Tc tc1;
  Tc tc2;
  Pwm pwm;
  Adc adc;
  Dacc dacc;
  Trng trng;
  Uotghs uotghs;
  Uart uart;

 private:
  void reset(ResetType type, bool processor_only);
  void carry_out_resets();
  void check_waits();
  void boot();

  Scheduler::Id id_;
  bool powered_ = false;
  bool in_rom_ = false;
  std::uint64_t resets_ = 0;
  ResetType last_reset_ = ResetType::kGeneral;
};

}  // namespace due_emulator
