// The block of three channels: its registers, its pins and the decoder; see tc.hpp.
#include "chip/tc.hpp"

namespace due_emulator {

namespace {

using access::kBoth;
using access::kRead;
using access::kUnmodelled;
using access::kWrite;

constexpr Register kRegisters[] = {
    {0x00, "TC_CCR0", kWrite},
    {0x04, "TC_CMR0", kBoth},
    {0x08, "TC_SMMR0", kBoth | kUnmodelled},
    {0x10, "TC_CV0", kRead},
    {0x14, "TC_RA0", kBoth},
    {0x18, "TC_RB0", kBoth},
    {0x1C, "TC_RC0", kBoth},
    {0x20, "TC_SR0", kRead},
    {0x24, "TC_IER0", kWrite},
    {0x28, "TC_IDR0", kWrite},
    {0x2C, "TC_IMR0", kRead},
    {0x40, "TC_CCR1", kWrite},
    {0x44, "TC_CMR1", kBoth},
    {0x48, "TC_SMMR1", kBoth | kUnmodelled},
    {0x50, "TC_CV1", kRead},
    {0x54, "TC_RA1", kBoth},
    {0x58, "TC_RB1", kBoth},
    {0x5C, "TC_RC1", kBoth},
    {0x60, "TC_SR1", kRead},
    {0x64, "TC_IER1", kWrite},
    {0x68, "TC_IDR1", kWrite},
    {0x6C, "TC_IMR1", kRead},
    {0x80, "TC_CCR2", kWrite},
    {0x84, "TC_CMR2", kBoth},
    {0x88, "TC_SMMR2", kBoth | kUnmodelled},
    {0x90, "TC_CV2", kRead},
    {0x94, "TC_RA2", kBoth},
    {0x98, "TC_RB2", kBoth},
    {0x9C, "TC_RC2", kBoth},
    {0xA0, "TC_SR2", kRead},
    {0xA4, "TC_IER2", kWrite},
    {0xA8, "TC_IDR2", kWrite},
    {0xAC, "TC_IMR2", kRead},
    {0xC0, "TC_BCR", kWrite},
    {0xC4, "TC_BMR", kBoth},
    {0xC8, "TC_QIER", kWrite},
    {0xCC, "TC_QIDR", kWrite},
    {0xD0, "TC_QIMR", kRead},
    {0xD4, "TC_QISR", kRead},
    {0xD8, "TC_FMR", kBoth | kUnmodelled},
    {0xE4, "TC_WPMR", kBoth | kUnmodelled},
};

// Offsets of the registers that the code below names.
constexpr std::uint32_t kBcr = 0xC0;
constexpr std::uint32_t kBmr = 0xC4;
constexpr std::uint32_t kQier = 0xC8;
constexpr std::uint32_t kQidr = 0xCC;
constexpr std::uint32_t kQimr = 0xD0;
constexpr std::uint32_t kQisr = 0xD4;

constexpr const char* kNames[] = {"TC0", "TC1", "TC2"};
constexpr std::uint32_t kSpeedEn = 1U << 10;        // TC_BMR.SPEEDEN
constexpr std::uint32_t kBmrMask = 0x03FBFF3F;      // the fields that TC_BMR has
constexpr std::uint32_t kQisrDir = 1U << 8;         // TC_QISR.DIR: downwards
constexpr std::uint32_t kQuadratureInterrupts = 7;  // IDX, DIRCHG, QERR
constexpr std::uint32_t kChannelBytes = 0x40;       // from one channel's registers to the next's

}  // namespace

// Block `index` of three; follows and drives the pins that the wiring gives it.
Tc::Tc(System& system, Pins& pins, int index, const Wiring& wiring)
    : Peripheral(system, kNames[index], 0x40080000U + 0x4000U * static_cast<std::uint32_t>(index),
                 0x4000, id::kTc0 + 3 * index, kRegisters),
      pins_(pins),
      wiring_(wiring),
      channels_{{system, *this, 0, id::kTc0 + 3 * index},
                {system, *this, 1, id::kTc0 + 3 * index + 1},
                {system, *this, 2, id::kTc0 + 3 * index + 2}},
      quadrature_(*this) {
  for (int channel = 0; channel < 3; ++channel) {
    for (const bool is_a : {true, false}) {
      const int pin = is_a ? wiring.tioa[channel] : wiring.tiob[channel];
      const int signal = 2 * channel + (is_a ? 0 : 1);
      if (pin < 0) continue;
      pins.connect_listener(pin, this, signal);
      pins.connect_driver(pin, wiring.peripheral_b, this, signal);
    }
  }
}

void Tc::reset() {
  block_mode_ = quadrature_interrupts_ = 0;
  quadrature_.reset();
  for (TcChannel& channel : channels_) channel.reset();
}

// Each channel has its own clock; the block's registers run on that of channel 0.
int Tc::clock_of(std::uint32_t offset) const {
  return offset < kBcr ? clock_id_ + static_cast<int>(offset / kChannelBytes) : clock_id_;
}

// Level at TIOA or TIOB of a channel; low if the pin is not brought out.
bool Tc::pin_level(int channel, bool is_a) const {
  const int pin = is_a ? wiring_.tioa[channel] : wiring_.tiob[channel];
  return pin >= 0 && pins_.level(pin);
}

// A channel drives TIOA in waveform mode, and TIOB unless that is its event input (EEVT = 0).
bool Tc::drives(int signal) const {
  const TcChannel& channel = channels_[signal / 2];
  if (!channel.is_wave()) return false;
  return signal % 2 == 0 || !channel.event_is_tiob();
}

// `signal`: 2 * channel for TIOA, one more for TIOB.
bool Tc::level(int signal) const {
  const TcChannel& channel = channels_[signal / 2];
  return signal % 2 == 0 ? channel.output_a() : channel.output_b();
}

// A channel has changed its output: the pin's wire may change too.
void Tc::output_changed(int channel, bool is_a) {
  const int pin = is_a ? wiring_.tioa[channel] : wiring_.tiob[channel];
  if (pin >= 0) pins_.refresh(pin, system_.now());
}

void Tc::not_modelled_in(int channel, std::uint32_t offset, const std::string& text) const {
  not_modelled(offset + kChannelBytes * static_cast<std::uint32_t>(channel), text);
}

void Tc::misuse_in(int channel, std::uint32_t offset, const std::string& text) const {
  misuse(offset + kChannelBytes * static_cast<std::uint32_t>(channel), text);
}

// A step of the decoder: channel 0 counts it in position mode (POSEN).
void Tc::quadrature_step(int direction) {
  if (quadrature_.position() && channels_[0].counts_external()) channels_[0].count(direction);
}

// An edge at TIOA0 or TIOB0, the decoder's inputs; the other channels' pins are not inputs here.
void Tc::pin_changed(int signal, bool level, std::uint64_t now) {
  const int channel = signal / 2;
  const bool is_a = signal % 2 == 0;
  if (channel != 0 || !quadrature_.enabled() || !system_.clocked(clock_id_)) return;
  quadrature_.input(is_a, level, now);
  if (quadrature_interrupts_ != 0) channels_[0].update_irq();
}

// Registers whose bits follow the pins or the time: to wait for them is no mistake.
std::uint32_t Tc::from_outside(std::uint32_t offset) const {
  if (offset == kQisr) return ~0U;
  // A channel's CV, RA, RB, RC and SR.
  return offset % kChannelBytes >= 0x10 && offset % kChannelBytes <= 0x20 ? ~0U : 0;
}

// A channel's register, or one of the block from TC_BCR on. First, edges pass the decoder's filter.
std::uint32_t Tc::read(std::uint32_t offset) {
  if (quadrature_.enabled()) quadrature_.settle(system_.now());
  if (offset < kBcr) return channels_[offset / kChannelBytes].read(offset % kChannelBytes);
  switch (offset) {
    case kBmr:
      return block_mode_;
    case kQimr:
      return quadrature_interrupts_;
    case kQisr: {
      const std::uint32_t value =
          quadrature_.take_flags() | (quadrature_.direction_down() ? kQisrDir : 0U);
      channels_[0].update_irq();
      return value;
    }
    default:
      return 0;
  }
}

// TC_BCR triggers all channels at once; TC_BMR sets the decoder; TC_QIER and TC_QIDR its
// interrupts.
void Tc::write(std::uint32_t offset, std::uint32_t value) {
  if (quadrature_.enabled()) quadrature_.settle(system_.now());
  if (offset < kBcr) return channels_[offset / kChannelBytes].write(offset % kChannelBytes, value);
  switch (offset) {
    case kBcr:
      if ((value & 1U) == 0) return;  // SYNC
      for (TcChannel& channel : channels_) channel.software_trigger();
      return;
    case kBmr:
      block_mode_ = value & kBmrMask;
      if ((value & kSpeedEn) != 0) not_modelled(offset, "speed measurement is not modelled");
      quadrature_.set_mode(block_mode_, pin_level(0, true), pin_level(0, false));
      return;
    case kQier:
      quadrature_interrupts_ |= value & kQuadratureInterrupts;
      break;
    case kQidr:
      quadrature_interrupts_ &= ~value;
      break;
    default:
      break;
  }
  channels_[0].update_irq();
}

}  // namespace due_emulator
