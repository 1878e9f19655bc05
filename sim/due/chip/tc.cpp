// The block of three channels with its registers, pins and decoder, and the channels; see tc.hpp.
#include "chip/tc.hpp"

#include <algorithm>
#include <utility>

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

// TC_SR: overflow, and compares with RA, RB and RC.
constexpr std::uint32_t kCovfs = 1U << 0;
constexpr std::uint32_t kCpas = 1U << 2;
constexpr std::uint32_t kCpbs = 1U << 3;
constexpr std::uint32_t kCpcs = 1U << 4;

// TC_CMR. Bit 15 chooses capture or waveform mode; several bits mean something else in each.
constexpr std::uint32_t kTcclks = 7;    // clock of the counter
constexpr std::uint32_t kClockXc0 = 5;  // TCCLKS: the quadrature decoder's steps
constexpr std::uint32_t kBurst = 3U << 4;
constexpr std::uint32_t kCpcStop = 1U << 6;     // waveform: a compare with RC stops the clock
constexpr std::uint32_t kCpcDis = 1U << 7;      // waveform: it disables the clock
constexpr std::uint32_t kEventEdge = 3U << 8;   // ETRGEDG or EEVTEDG
constexpr std::uint32_t kResetAtRc = 1U << 14;  // CPCTRG, or WAVSEL = 2 or 3
constexpr std::uint32_t kWave = 1U << 15;
constexpr std::uint32_t kLoads = 0xFU << 16;       // capture: LDRA and LDRB
constexpr std::uint32_t kEffects = 0xFFFFU << 16;  // waveform: all effects on TIOA and TIOB
// Lowest bit of an effect field, which has two bits.
constexpr unsigned kAcpa = 16;
constexpr unsigned kAcpc = 18;
constexpr unsigned kAswtrg = 22;
constexpr unsigned kBcpb = 24;
constexpr unsigned kBcpc = 26;
constexpr unsigned kBswtrg = 30;

constexpr std::uint64_t kWhole = std::uint64_t{1} << 32;  // values of the counter

// Offsets of a channel's registers.
constexpr std::uint32_t kCcr = 0x00;
constexpr std::uint32_t kCmr = 0x04;
constexpr std::uint32_t kCv = 0x10;
constexpr std::uint32_t kRa = 0x14;
constexpr std::uint32_t kRb = 0x18;
constexpr std::uint32_t kRc = 0x1C;
constexpr std::uint32_t kSr = 0x20;
constexpr std::uint32_t kIer = 0x24;
constexpr std::uint32_t kIdr = 0x28;
constexpr std::uint32_t kImr = 0x2C;

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

TcChannel::TcChannel(System& system, Tc& block, int index, int identifier)
    : system_(system),
      block_(block),
      index_(index),
      identifier_(identifier),
      id_(system.scheduler.add(this)) {}

void TcChannel::reset() {
  mode_ = ra_ = rb_ = rc_ = status_ = interrupts_ = held_ = 0;
  enabled_ = running_ = clears_ = level_a_ = level_b_ = false;
  plan();
  update_irq();
}

// Processor cycles per step of the counter, by TCCLKS; 0 if it counts edges instead of time.
std::uint64_t TcChannel::step() const {
  switch (mode_ & kTcclks) {
    case 0:
      return 2;
    case 1:
      return 8;
    case 2:
      return 32;
    case 3:
      return 128;
    case 4:  // the slow clock
      return std::max<std::uint64_t>(system_.clock.mck_Hz() / system_.slow_Hz, 1);
    default:
      return 0;
  }
}

// True after a trigger until the next edge of the counter's clock: the counter keeps its old value.
bool TcChannel::pending() const {
  return step() != 0 ? system_.now() / step() < start_step_ : clears_;
}

// Clock steps since the counter was 0. The prescaler runs freely; the counter moves on its edges.
std::uint64_t TcChannel::ticks(std::uint64_t now) const { return now / step() - start_step_; }

// Whether the counter begins at 0 again (or turns, in up-down modes) when it reaches RC.
bool TcChannel::resets_at_rc() const { return (mode_ & kResetAtRc) != 0; }

// Steps after which the counter repeats itself.
std::uint64_t TcChannel::period() const {
  const std::uint64_t top = resets_at_rc() && rc_ != 0 ? rc_ : kWhole;
  return updown() ? 2 * top : top;
}

// TC_CV now.
std::uint32_t TcChannel::value() const {
  if (!running_ || step() == 0 || pending()) return held_;
  const std::uint64_t phase = ticks(system_.now()) % period();
  const std::uint64_t top = period() / 2;
  return static_cast<std::uint32_t>(updown() && phase > top ? period() - phase : phase);
}

// First tick after `after` at which the counter becomes `compare`.
std::uint64_t TcChannel::next_match(std::uint64_t after, std::uint32_t compare) const {
  const std::uint64_t whole = period();
  const std::uint64_t top = updown() ? whole / 2 : whole;
  if (compare > top) return kNever;
  const auto next = [after, whole](std::uint64_t phase) {
    phase %= whole;
    const std::uint64_t here = after % whole;
    return after + (phase > here ? phase - here : phase + whole - here);
  };
  // An up-down counter passes each value twice in a period.
  std::uint64_t match = next(compare);
  if (updown()) match = std::min(match, next(whole - compare));
  return match;
}

// Applies an effect field of TC_CMR (ACPA and the like) to an output: 0 none, 1 set, 2 clear, 3
// toggle.
void TcChannel::effect(bool& level, std::uint32_t code, bool is_a) {
  const bool before = level;
  switch (code & 3U) {
    case 1:
      level = true;
      break;
    case 2:
      level = false;
      break;
    case 3:
      level = !level;
      break;
    default:
      break;
  }
  if (level != before) block_.output_changed(index_, is_a);
}

// A compare has matched: sets its status flag, and in waveform mode the outputs. The effects are
// TC_CMR shifted so that their fields are the low bits.
void TcChannel::matched(std::uint32_t flag, std::uint32_t a_effect, std::uint32_t b_effect) {
  status_ |= flag;
  if (!is_wave()) return;
  effect(level_a_, a_effect, true);
  effect(level_b_, b_effect, false);
}

// Applies the compares and overflows from the last call until now, in order of time.
void TcChannel::settle() {
  if (!running_ || step() == 0 || pending()) return;
  const std::uint64_t now = ticks(system_.now());
  while (running_) {
    const std::uint64_t at_ra = is_wave() ? next_match(seen_ticks_, ra_) : kNever;
    const std::uint64_t at_rb = is_wave() ? next_match(seen_ticks_, rb_) : kNever;
    const std::uint64_t at_rc = next_match(seen_ticks_, rc_ == 0 && resets_at_rc() ? 0 : rc_);
    const std::uint64_t overflow = (seen_ticks_ / kWhole + 1) * kWhole;
    const bool overflows = !resets_at_rc() && !updown();
    const std::uint64_t first = std::min({at_ra, at_rb, at_rc, overflows ? overflow : kNever});
    if (first > now) break;
    // After a long time without a call, only the last two periods are applied one by one.
    if (now - first > 4 * period()) {
      seen_ticks_ = now - now % period() - 2 * period();
      status_ |= (is_wave() ? kCpas | kCpbs : 0U) | kCpcs | (overflows ? kCovfs : 0U);
      continue;
    }
    seen_ticks_ = first;
    if (at_ra == first) matched(kCpas, mode_ >> kAcpa, 0);
    if (at_rb == first) matched(kCpbs, 0, mode_ >> kBcpb);
    if (overflows && overflow == first) status_ |= kCovfs;
    if (at_rc == first) {
      matched(kCpcs, mode_ >> kAcpc, mode_ >> kBcpc);
      const bool stops = is_wave() && (mode_ & kCpcStop) != 0;
      const bool disables = is_wave() && (mode_ & kCpcDis) != 0;
      if (stops || disables) {
        held_ = resets_at_rc() ? 0 : rc_;
        running_ = false;
        if (disables) enabled_ = false;
      }
    }
  }
  seen_ticks_ = std::max(seen_ticks_, now);
}

// Schedules an event for the next compare that an interrupt, an output or CPCSTOP waits for.
void TcChannel::plan() {
  std::uint64_t due_cycle = kNever;
  if (running_ && step() != 0) {
    std::uint64_t due_tick = kNever;
    const bool drives = is_wave() && (mode_ & kEffects) != 0;
    const bool stops = is_wave() && (mode_ & (kCpcStop | kCpcDis)) != 0;
    // Whether a compare must be acted on in time: `effects` are its fields in TC_CMR.
    const auto wanted = [&](std::uint32_t flag, std::uint32_t effects) {
      return (interrupts_ & flag) != 0 || (drives && (mode_ & effects) != 0);
    };
    if (is_wave() && wanted(kCpas, 3U << kAcpa))
      due_tick = std::min(due_tick, next_match(seen_ticks_, ra_));
    if (is_wave() && wanted(kCpbs, 3U << kBcpb))
      due_tick = std::min(due_tick, next_match(seen_ticks_, rb_));
    if (wanted(kCpcs, (3U << kAcpc) | (3U << kBcpc)) || stops) {
      due_tick = std::min(due_tick, next_match(seen_ticks_, rc_));
    }
    if ((interrupts_ & kCovfs) != 0)
      due_tick = std::min(due_tick, (seen_ticks_ / kWhole + 1) * kWhole);
    if (due_tick != kNever) due_cycle = (due_tick + start_step_) * step();
  }
  system_.scheduler.set(id_, due_cycle);
}

// A compare or an overflow for which plan() has scheduled this.
void TcChannel::event(std::uint64_t) {
  settle();
  update_irq();
  plan();
}

void TcChannel::update_irq() {
  const bool quadrature = index_ == 0 && block_.quadrature_irq();
  system_.set_irq(identifier_, (status_ & interrupts_) != 0 || quadrature);
}

// Lets the counter run on from this value, in steps, now.
void TcChannel::restart(std::uint32_t from) {
  running_ = enabled_;
  clears_ = false;
  held_ = from;
  if (step() != 0) start_step_ = system_.now() / step() - from;
  seen_ticks_ = from;
}

// "The counter value passes to zero on the next valid edge of the selected clock" (36.6.2): that
// edge is not counted, be it a step of the quadrature decoder.
void TcChannel::trigger() {
  const std::uint32_t before = value();
  restart(0);
  if (!running_) return;
  held_ = before;
  clears_ = step() == 0;
  if (step() != 0) ++start_step_;
}

// TC_CCR.CLKDIS: the counter keeps its value.
void TcChannel::stop() {
  held_ = value();
  running_ = enabled_ = false;
}

// One step of the quadrature decoder, up (+1) or down (-1). After a trigger, the step clears the
// counter instead of moving it.
void TcChannel::count(int direction) {
  if (std::exchange(clears_, false)) {
    held_ = 0;
    return;
  }
  const std::uint32_t before = held_;
  held_ += static_cast<std::uint32_t>(direction);
  if (direction > 0 && before == ~0U) status_ |= kCovfs;
  if (held_ == rc_) status_ |= kCpcs;
  if ((status_ & interrupts_) != 0) update_irq();
}

// TC_CCR.SWTRG or TC_BCR.SYNC: a trigger, with its effects on the outputs.
void TcChannel::software_trigger() {
  settle();
  trigger();
  if (is_wave()) {
    effect(level_a_, mode_ >> kAswtrg, true);
    effect(level_b_, mode_ >> kBswtrg, false);
  }
  plan();
}

// Status and counter first become what they are at this time.
std::uint32_t TcChannel::read(std::uint32_t offset) {
  settle();
  plan();
  switch (offset) {
    case kCmr:
      return mode_;
    case kCv:
      return value();
    case kRa:
      return ra_;
    case kRb:
      return rb_;
    case kRc:
      return rc_;
    case kImr:
      return interrupts_;
    // Reading clears the flags. Bits 16 to 18 are CLKSTA, MTIOA, MTIOB.
    case kSr: {
      const bool a = is_wave() ? level_a_ : block_.pin_level(index_, true);
      const bool b = is_wave() ? level_b_ : block_.pin_level(index_, false);
      const std::uint32_t value =
          status_ | (enabled_ ? 1U << 16 : 0U) | (a ? 1U << 17 : 0U) | (b ? 1U << 18 : 0U);
      status_ = 0;
      update_irq();
      return value;
    }
    default:
      return 0;
  }
}

// TC_CCR: CLKEN is bit 0, CLKDIS bit 1, SWTRG bit 2; disabling has priority.
void TcChannel::write_control(std::uint32_t value) {
  if ((value & 2U) != 0) {
    stop();
  } else if ((value & 1U) != 0) {
    enabled_ = true;
  }
  if ((value & 4U) != 0) software_trigger();
}

// TC_CMR. Refuses what is not modelled; a running counter keeps its value.
void TcChannel::write_mode(std::uint32_t value) {
  const std::uint32_t at = value != 0 || running_ ? this->value() : 0;
  const bool quadrature = (value & kTcclks) == kClockXc0 && index_ == 0;
  if ((value & kTcclks) >= kClockXc0 && !quadrature) {
    block_.not_modelled_in(index_, kCmr,
                           "external clocks other than the decoder's are not modelled");
  }
  if ((value & kBurst) != 0) block_.not_modelled_in(index_, kCmr, "BURST is not modelled");
  if ((value & kWave) != 0 && (value & kEventEdge) != 0) {
    block_.not_modelled_in(index_, kCmr, "external events in waveform mode are not modelled");
  }
  // The decoder of channel 0 takes the pins; then ETRGEDG chooses the edge of an index pulse.
  if ((value & kWave) == 0 && (value & (quadrature ? kLoads : kLoads | kEventEdge)) != 0) {
    block_.not_modelled_in(index_, kCmr, "captures and triggers by TIOA or TIOB are not modelled");
  }
  const bool triggered = running_ && pending();
  mode_ = value;
  if (running_) restart(at);
  if (triggered) trigger();
}

// Compares up to now happen with the old values; then the write acts.
void TcChannel::write(std::uint32_t offset, std::uint32_t value) {
  settle();
  switch (offset) {
    case kCcr:
      write_control(value);
      break;
    case kCmr:
      write_mode(value);
      break;
    case kRa:
      if (!is_wave()) block_.misuse_in(index_, offset, "RA is read-only in capture mode");
      ra_ = value;
      break;
    case kRb:
      if (!is_wave()) block_.misuse_in(index_, offset, "RB is read-only in capture mode");
      rb_ = value;
      break;
    case kRc: {
      // The counter goes on from its value with the new period.
      const std::uint32_t at = this->value();
      rc_ = value;
      if (!running_ || !resets_at_rc() || pending()) break;
      if (at >= value) block_.misuse_in(index_, offset, "RC is set below the running counter");
      restart(at);
      break;
    }
    case kIer:
      interrupts_ |= value & 0xFFU;
      break;
    case kIdr:
      interrupts_ &= ~value;
      break;
    default:
      break;
  }
  update_irq();
  plan();
}

}  // namespace due_emulator
