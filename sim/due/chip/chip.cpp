// Connects the peripherals, and resets and powers all of them; see chip.hpp.
#include "chip/chip.hpp"

#include <algorithm>

namespace due_emulator {

namespace {

// A peripheral that the chip has and the model has not: an access is reported with its name.
struct Block {
  std::uint32_t base;
  std::uint32_t size;
  const char* name;
};

constexpr Block kUnmodelled[] = {
    {0x40000000, 0x4000, "HSMCI"},  {0x40004000, 0x4000, "SSC"},    {0x40008000, 0x4000, "SPI0"},
    {0x4008C000, 0x4000, "TWI0"},   {0x40090000, 0x4000, "TWI1"},   {0x40098000, 0x4000, "USART0"},
    {0x4009C000, 0x4000, "USART1"}, {0x400A0000, 0x4000, "USART2"}, {0x400A4000, 0x4000, "USART3"},
    {0x400B0000, 0x4000, "EMAC"},   {0x400B4000, 0x4000, "CAN0"},   {0x400B8000, 0x4000, "CAN1"},
    {0x400C4000, 0x4000, "DMAC"},   {0x400E0000, 0x200, "SMC"},     {0x400E0200, 0x200, "SDRAMC"},
    {0x400E0400, 0x200, "MATRIX"},  {0x400E1A10, 0x20, "SUPC"},     {0x400E1A30, 0x10, "RTT"},
    {0x400E1A60, 0x30, "RTC"},
};

// Pins of TIOA and TIOB (section 9.2); PB0 and PB1 of TC1 are not brought out on the Due.
constexpr Tc::Wiring kTc0 = {{pin_of('B', 25), -1, -1}, {pin_of('B', 27), -1, -1}, true};
constexpr Tc::Wiring kTc1 = {{pin_of('B', 0), pin_of('B', 2), pin_of('B', 4)},
                             {pin_of('B', 1), pin_of('B', 3), pin_of('B', 5)},
                             true};
constexpr Tc::Wiring kTc2 = {{pin_of('C', 25), pin_of('C', 28), pin_of('D', 7)},
                             {pin_of('C', 26), pin_of('C', 29), pin_of('D', 8)},
                             true};

// The reset controller holds the core for three periods of the slow clock.
constexpr std::uint64_t kResetPeriods = 3;

// For check_waits(): a wait loop may last this long; how often it is looked for; and the steps
// within which the program must be back at its load, interrupts included.
constexpr BoardTime kLongestWait = 500 * kOneMs;
constexpr BoardTime kWatchEvery = 10 * kOneMs;
constexpr int kMaxSteps = 10000;

}  // namespace

// Makes all peripherals with their base addresses, and holds the processor until the power comes.
Chip::Chip()
    : scs(system.cpu, system.exceptions, system.scheduler, system.diagnostics),
      pins(system.diagnostics),
      flash(system),
      pmc(system),
      efc0(system, flash, 0),
      efc1(system, flash, 1),
      wdt(system),
      rstc(system),
      gpbr(system),
      chipid(system),
      pioa(system, pins, 0, "PIOA", 0x400E0E00),
      piob(system, pins, 1, "PIOB", 0x400E1000),
      pioc(system, pins, 2, "PIOC", 0x400E1200),
      piod(system, pins, 3, "PIOD", 0x400E1400),
      tc0(system, pins, 0, kTc0),
      tc1(system, pins, 1, kTc1),
      tc2(system, pins, 2, kTc2),
      pwm(system, pins),
      adc(system),
      dacc(system),
      trng(system),
      uotghs(system),
      uart(system, pins),
      id_(system.scheduler.add(this)) {
  system.bus.connect(&system.cpu, &scs, &flash);
  for (const Block& block : kUnmodelled)
    system.bus.add_unmodelled(block.base, block.size, block.name);
  // The board joins D4's PC26 with PA29 and D10's PC29 with PA28.
  pins.join(pin_of('C', 26), pin_of('A', 29));
  pins.join(pin_of('C', 29), pin_of('A', 28));
  system.exceptions.reset();
  system.cpu.hold(true);
}

void Chip::power_on() {
  // Any pattern that no program expects.
  std::fill(system.memory.ram.begin(), system.memory.ram.end(), std::uint8_t{0x5B});
  system.memory.ram_code.fill(0);
  gpbr.power_lost();
  powered_ = true;
  reset(ResetType::kGeneral, false);
}

// A flash command that runs is cut off, and all outputs are released.
void Chip::power_off() {
  efc0.cut();
  efc1.cut();
  // Every output lets go of its pin.
  for (Peripheral* peripheral : system.peripherals) peripheral->reset();
  powered_ = false;
  system.cpu.hold(true);
}

// Carries out a reset (RSTC_SR.RSTTYP gives its type) and holds the processor for three periods of
// the slow clock; then event() starts it. `processor_only`: the peripherals go on.
void Chip::reset(ResetType type, bool processor_only) {
  system.reset_wanted = false;
  scs.reset_requested = false;
  ++resets_;
  last_reset_ = type;
  system.exceptions.reset();
  scs.reset();
  if (!processor_only) {
    for (Peripheral* peripheral : system.peripherals) peripheral->reset();
  }
  rstc.note(type);
  system.cpu.hold(true);
  system.scheduler.set(
      id_, system.clock.cycle_at(system.board_now() + system.slow_periods(kResetPeriods)));
}

// The end of a reset.
void Chip::event(std::uint64_t) {
  if (rstc.nrst_low() || !powered_) return;
  boot();
}

// Starts the program in flash; if GPNVM bit 1 is clear, the chip is in its boot ROM instead.
void Chip::boot() {
  in_rom_ = (flash.gpnvm & 2U) == 0;
  system.cpu.reset();
  if (in_rom_) return;
  system.cpu.hold(false);
}

// The NRST pin changes. Its release starts the processor three periods of the slow clock later.
void Chip::set_nrst(bool low) {
  const bool was = rstc.nrst_low();
  rstc.set_nrst(low);
  if (was && !low && powered_) {
    system.scheduler.set(
        id_, system.clock.cycle_at(system.board_now() + system.slow_periods(kResetPeriods)));
  }
}

// Resets that the last instructions have asked for (AIRCR, RSTC, watchdog, NRST).
void Chip::carry_out_resets() {
  if (scs.reset_requested && !system.reset_wanted) system.request_reset(ResetType::kSoftware);
  if (system.reset_wanted && powered_) reset(system.reset_type, system.processor_only);
  system.reset_wanted = false;
}

// With the check of wait loops, runs in slices of kWatchEvery and looks for such a loop after each.
void Chip::run_until(BoardTime until) {
  const bool watched = system.diagnostics.strict(Trouble::kWait);
  while (system.board_now() < until && system.cpu.halt() == Halt::kNone) {
    const BoardTime slice_end = watched ? std::min(until, system.board_now() + kWatchEvery) : until;
    system.cpu.run(system.clock.cycle_at(slice_end));
    carry_out_resets();
    if (watched) check_waits();
  }
}

// Reports a program that has waited for 0.5 s for a bit of a register that can no longer change:
// one that follows neither pins nor time. Runs the program on to its load, then asks which bits
// would end the loop.
void Chip::check_waits() {
  const Cpu& cpu = system.cpu;
  WaitLoops::Loop& loop = system.bus.waits.at_level_of(cpu);
  const std::size_t level = cpu.nesting();
  if (system.board_now() - system.clock.time_at(loop.since) < kLongestWait) return;
  // Runs on to the load, through the handlers that interrupt the loop.
  for (int i = 0; cpu.nesting() != level || cpu.pc() != loop.pc; ++i) {
    const bool inside = cpu.nesting() > level || WaitLoops::stands_in(cpu, loop);
    if (i == kMaxSteps || !inside || cpu.held() || cpu.sleeping() || cpu.halt() != Halt::kNone)
      return;
    step();
  }
  if (!WaitLoops::stands_in(cpu, loop)) return;
  const WaitLoops::Loop before = loop;
  const std::uint32_t bits = system.cpu.deciding_bits(before.value);
  const std::uint32_t outside = system.bus.outside_bits(before.address);
  if ((bits & outside) != 0 || (bits == 0 && outside != 0)) {
    loop.since = cpu.cycles();  // the wait can end: look again later
    return;
  }
  std::string wanted;
  for (unsigned bit = 0; bit < 32; ++bit) {
    if (((bits >> bit) & 1U) != 0) wanted += (wanted.empty() ? "" : ", ") + std::to_string(bit);
  }
  const bool is_single = (bits & (bits - 1)) == 0;
  const std::string what = bits == 0   ? "the program waits for no single bit of it"
                           : is_single ? "the program waits for its bit " + wanted
                                       : "the program waits for one of its bits " + wanted;
  system.diagnostics.report(Trouble::kWait, before.address,
                            "for 0.5 s a loop has read " + system.bus.name_of(before.address) +
                                ", which stays " + hex(before.value) + ": " + what);
}

void Chip::step() {
  system.cpu.step(kNever - 1);
  carry_out_resets();
}

}  // namespace due_emulator
