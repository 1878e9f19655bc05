// A new random value every 84 cycles, from a seeded generator; see trng.hpp.
#include "chip/trng.hpp"

namespace due_emulator {

namespace {

using access::kRead;
using access::kWrite;

constexpr Register kRegisters[] = {
    {0x00, "TRNG_CR", kWrite}, {0x10, "TRNG_IER", kWrite}, {0x14, "TRNG_IDR", kWrite},
    {0x18, "TRNG_IMR", kRead}, {0x1C, "TRNG_ISR", kRead},  {0x50, "TRNG_ODATA", kRead},
};

// Offsets of the registers that the code below names.
constexpr std::uint32_t kCr = 0x00;
constexpr std::uint32_t kIdr = 0x14;
constexpr std::uint32_t kImr = 0x18;
constexpr std::uint32_t kIsr = 0x1C;

constexpr std::uint32_t kKey = 0x524E47;  // "RNG"

// SplitMix64 (Steele, Lea, Flood 2014): every seed, also a small one, gives well-mixed words.
std::uint32_t mixed(std::uint64_t z) {
  z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9U;
  z = (z ^ (z >> 27)) * 0x94D049BB133111EBU;
  return static_cast<std::uint32_t>((z ^ (z >> 31)) >> 32);
}

}  // namespace

Trng::Trng(System& system)
    : Peripheral(system, "TRNG", 0x400BC000, 0x4000, id::kTrng, kRegisters),
      id_(system.scheduler.add(this)) {}

void Trng::reset() {
  enabled_ = false;
  masked_ = true;
  ready_ = false;
  value_ = 0;
  update();
}

// TRNG_CR.ENABLE: the first value comes 84 cycles later.
void Trng::enable(bool on) {
  if (on && !enabled_) next_ = system_.now() + kCycles;
  enabled_ = on;
  if (!on) ready_ = false;
}

// The last value that is complete by now; values in between are skipped, as on the chip.
void Trng::catch_up() {
  if (!enabled_ || system_.now() < next_) return;
  const std::uint64_t values = (system_.now() - next_) / kCycles + 1;
  next_ += values * kCycles;
  state_ += values * 0x9E3779B97F4A7C15U;  // SplitMix64's step: 2^64 / golden ratio
  value_ = mixed(state_);
  ready_ = true;
}

// Sets the interrupt line, and schedules the next value if an interrupt waits for it.
void Trng::update() {
  system_.set_irq(id::kTrng, ready_ && !masked_);
  system_.scheduler.set(id_, enabled_ && !masked_ && !ready_ ? next_ : kNever);
}

void Trng::event(std::uint64_t) {
  catch_up();
  update();
}

// TRNG_ODATA (default), TRNG_IMR, or TRNG_ISR, which reading clears.
std::uint32_t Trng::read(std::uint32_t offset) {
  catch_up();
  std::uint32_t value = value_;
  if (offset == kImr) value = masked_ ? 0 : 1;
  if (offset == kIsr) {
    value = ready_ ? 1 : 0;
    ready_ = false;
  }
  update();
  return value;
}

// TRNG_CR switches the generator with its key; TRNG_IER and TRNG_IDR set the interrupt's mask.
void Trng::write(std::uint32_t offset, std::uint32_t value) {
  catch_up();
  if (offset == kCr) {
    if (value >> 8 != kKey) return misuse(offset, "write without its key 0x524E47");
    enable((value & 1U) != 0);
  } else if ((value & 1U) != 0) {
    masked_ = offset == kIdr;
  }
  update();
}

}  // namespace due_emulator
