// Registers, channels, synchronous updates, overrides and faults of the PWM controller: pwm.hpp.
#include "chip/pwm.hpp"

#include <algorithm>

namespace due_emulator {

namespace {

using access::kBoth;
using access::kRead;
using access::kUnmodelled;
using access::kWrite;

constexpr std::uint8_t kLater = kUnmodelled;

constexpr Register kRegisters[] = {
    {0x00, "PWM_CLK", kBoth},
    {0x04, "PWM_ENA", kWrite},
    {0x08, "PWM_DIS", kWrite},
    {0x0C, "PWM_SR", kRead},
    {0x10, "PWM_IER1", kWrite | kLater},
    {0x14, "PWM_IDR1", kWrite | kLater},
    {0x18, "PWM_IMR1", kRead | kLater},
    {0x1C, "PWM_ISR1", kRead | kLater},
    {0x20, "PWM_SCM", kBoth},
    {0x28, "PWM_SCUC", kBoth},
    {0x2C, "PWM_SCUP", kBoth | kLater},
    {0x30, "PWM_SCUPUPD", kWrite | kLater},
    {0x34, "PWM_IER2", kWrite | kLater},
    {0x38, "PWM_IDR2", kWrite | kLater},
    {0x3C, "PWM_IMR2", kRead | kLater},
    {0x40, "PWM_ISR2", kRead | kLater},
    {0x44, "PWM_OOV", kBoth},
    {0x48, "PWM_OS", kBoth},
    {0x4C, "PWM_OSS", kWrite},
    {0x50, "PWM_OSC", kWrite},
    {0x54, "PWM_OSSUPD", kWrite | kLater},
    {0x58, "PWM_OSCUPD", kWrite | kLater},
    {0x5C, "PWM_FMR", kBoth},
    {0x60, "PWM_FSR", kRead},
    {0x64, "PWM_FCR", kWrite},
    {0x68, "PWM_FPV", kBoth},
    {0x6C, "PWM_FPE1", kBoth},
    {0x70, "PWM_FPE2", kBoth},
    {0x7C, "PWM_ELMR0", kBoth | kLater},
    {0x80, "PWM_ELMR1", kBoth | kLater},
    {0xB0, "PWM_SMMR", kBoth | kLater},
    {0xE4, "PWM_WPCR", kWrite | kLater},
    {0xE8, "PWM_WPSR", kRead | kLater},
    {0x108, "PWM_TPR", kBoth | kLater},
    {0x10C, "PWM_TCR", kBoth | kLater},
    {0x118, "PWM_TNPR", kBoth | kLater},
    {0x11C, "PWM_TNCR", kBoth | kLater},
    {0x120, "PWM_PTCR", kWrite | kLater},
    {0x124, "PWM_PTSR", kRead | kLater},
#define COMPARISON(n)                                        \
  {0x130 + 16 * (n), "PWM_CMPV" #n, kBoth | kLater},         \
      {0x134 + 16 * (n), "PWM_CMPVUPD" #n, kWrite | kLater}, \
      {0x138 + 16 * (n), "PWM_CMPM" #n, kBoth | kLater}, {   \
    0x13C + 16 * (n), "PWM_CMPMUPD" #n, kWrite | kLater      \
  }
    COMPARISON(0),
    COMPARISON(1),
    COMPARISON(2),
    COMPARISON(3),
    COMPARISON(4),
    COMPARISON(5),
    COMPARISON(6),
    COMPARISON(7),
#undef COMPARISON
#define CHANNEL(n)                                                                            \
  {0x200 + 32 * (n), "PWM_CMR" #n, kBoth}, {0x204 + 32 * (n), "PWM_CDTY" #n, kBoth},          \
      {0x208 + 32 * (n), "PWM_CDTYUPD" #n, kWrite}, {0x20C + 32 * (n), "PWM_CPRD" #n, kBoth}, \
      {0x210 + 32 * (n), "PWM_CPRDUPD" #n, kWrite}, {0x214 + 32 * (n), "PWM_CCNT" #n, kRead}, \
      {0x218 + 32 * (n), "PWM_DT" #n, kBoth | kLater}, {                                      \
    0x21C + 32 * (n), "PWM_DTUPD" #n, kWrite | kLater                                         \
  }
    CHANNEL(0),
    CHANNEL(1),
    CHANNEL(2),
    CHANNEL(3),
    CHANNEL(4),
    CHANNEL(5),
    CHANNEL(6),
    CHANNEL(7),
#undef CHANNEL
};

struct PwmPin {
  int pin;
  int signal;  // see pwm.hpp
};

// Where the outputs come out, all on peripheral B.
constexpr PwmPin kPwmPins[] = {
    {pin_of('A', 8), 0},   {pin_of('A', 19), 1},  {pin_of('A', 13), 2},  {pin_of('A', 9), 3},
    {pin_of('A', 21), 8},  {pin_of('A', 12), 9},  {pin_of('A', 20), 10}, {pin_of('A', 0), 11},
    {pin_of('B', 12), 0},  {pin_of('B', 13), 1},  {pin_of('B', 14), 2},  {pin_of('B', 15), 3},
    {pin_of('B', 16), 8},  {pin_of('B', 17), 9},  {pin_of('B', 18), 10}, {pin_of('B', 19), 11},
    {pin_of('C', 3), 0},   {pin_of('C', 5), 1},   {pin_of('C', 7), 2},   {pin_of('C', 9), 3},
    {pin_of('C', 2), 8},   {pin_of('C', 4), 9},   {pin_of('C', 6), 10},  {pin_of('C', 8), 11},
    {pin_of('C', 20), 4},  {pin_of('C', 19), 5},  {pin_of('C', 18), 6},  {pin_of('C', 21), 12},
    {pin_of('C', 22), 13}, {pin_of('C', 23), 14}, {pin_of('C', 24), 15},
};

// Fault inputs PWMFI0 to PWMFI2.
constexpr PwmPin kFaultPins[] = {{pin_of('A', 5), 0}, {pin_of('A', 3), 1}, {pin_of('D', 6), 2}};

constexpr std::uint32_t kClk = 0x00;
constexpr std::uint32_t kEna = 0x04;
constexpr std::uint32_t kDis = 0x08;
constexpr std::uint32_t kSr = 0x0C;
constexpr std::uint32_t kScm = 0x20;
constexpr std::uint32_t kScuc = 0x28;
constexpr std::uint32_t kOov = 0x44;
constexpr std::uint32_t kOs = 0x48;
constexpr std::uint32_t kOss = 0x4C;
constexpr std::uint32_t kOsc = 0x50;
constexpr std::uint32_t kFmr = 0x5C;
constexpr std::uint32_t kFsr = 0x60;
constexpr std::uint32_t kFcr = 0x64;
constexpr std::uint32_t kFpv = 0x68;
constexpr std::uint32_t kFpe1 = 0x6C;  // fault enables of channels 0 to 3, one byte each
constexpr std::uint32_t kFpe2 = 0x70;  // of channels 4 to 7

// Registers of the channels, and the offsets in one channel's.
constexpr std::uint32_t kChannels = 0x200;
constexpr std::uint32_t kChannelBytes = 0x20;
constexpr std::uint32_t kCmr = 0x00;
constexpr std::uint32_t kCdty = 0x04;
constexpr std::uint32_t kCdtyupd = 0x08;
constexpr std::uint32_t kCprd = 0x0C;
constexpr std::uint32_t kCprdupd = 0x10;
constexpr std::uint32_t kCcnt = 0x14;

constexpr std::uint32_t kOverrideBits = 0x00FF00FFU;  // PWMH of each channel, and from bit 16 PWML
constexpr std::uint32_t kDeadTime = 1U << 16;         // PWM_CMR.DTE
constexpr std::uint32_t kCounterMask = 0xFFFFFFU;     // duty and period have 24 bits

std::uint32_t register_of(int channel, std::uint32_t offset) {
  return kChannels + kChannelBytes * static_cast<std::uint32_t>(channel) + offset;
}

// PWM_SCM
constexpr Field kSync{0, 8};  // channels of the synchronous group
constexpr Field kUpdm{16, 2};
constexpr std::uint32_t kScmMask = 0x00F000FF;  // SYNC, PTRM, PTRCS
// PWM_FMR: polarity, latching and filter of each fault input
constexpr Field kFpol{0, 8};
constexpr Field kFmod{8, 8};
constexpr Field kFfil{16, 8};
constexpr std::uint32_t kFmrMask = 0x00FFFFFF;
constexpr std::uint32_t kFaultInputs = 0x3F;  // there are six
// PWM_CLK, of clock A and from bit 16 of clock B
constexpr Field kDiv{0, 8};
constexpr Field kPre{8, 4};
constexpr std::uint32_t kClkMask = 0x0FFF0FFF;  // PREB, DIVB, PREA, DIVA
constexpr Field kClockA{0, 16};
constexpr Field kClockB{16, 16};
// PWM_CMR
constexpr Field kCpre{0, 4};
constexpr std::uint32_t kPolarity = 1U << 9;     // CPOL
constexpr std::uint32_t kInvertHigh = 1U << 17;  // DTHI
constexpr std::uint32_t kInvertLow = 1U << 18;   // DTLI

}  // namespace

int Pwm::signal_at(int pin) {
  for (const PwmPin& output : kPwmPins) {
    if (output.pin == pin) return output.signal;
  }
  return -1;
}

// Becomes a driver of all PWM pins and a listener of the fault pins.
Pwm::Pwm(System& system, Pins& pins)
    : Peripheral(system, "PWM", 0x40094000, 0x4000, id::kPwm, kRegisters),
      pins_(pins),
      id_(system.scheduler.add(this)),
      filter_id_(system.scheduler.add(&filter_)) {
  for (const PwmPin& pin : kPwmPins) pins.connect_driver(pin.pin, true, this, pin.signal);
  for (const PwmPin& pin : kFaultPins) pins.connect_listener(pin.pin, this, pin.signal);
}

// Only the counters of high cycles survive: their readers take differences.
void Pwm::reset() {
  const std::uint64_t now = system_.now();
  integrate_all();
  for (Channel& channel : channels_) {
    const std::uint64_t high[2] = {channel.high[0], channel.high[1]};
    channel = {};
    channel.counted = channel.origin = now;
    channel.high[0] = high[0];
    channel.high[1] = high[1];
  }
  clock_ = sync_ = override_value_ = override_ = 0;
  update_unlocked_ = false;
  fault_mode_ = faults_ = fault_values_ = 0;
  fault_enable_.fill(0);
  faulted_.fill(false);
  update_faults();
  plan();
}

// -- enabling and updating --------------------------------------------------------------------

// Enables one channel: its counter begins at 0.
void Pwm::start(int channel) {
  Channel& state = channels_[index(channel)];
  if (state.enabled) return;
  state.enabled = true;
  const std::uint64_t now = system_.now();
  // A synchronous channel joins the counter of channel 0.
  if (!synchronous(channel) || channel == 0) state.origin = now;
  if (state.duty > counter_of(channel).period) {
    // At PWM_CDTY of the channel.
    misuse(0x204U + 32U * static_cast<std::uint32_t>(channel), "CDTY is above CPRD");
  }
}

// PWM_ENA: with channel 0 of a synchronous group, all channels of the group.
void Pwm::enable(std::uint32_t mask) {
  if (has_bit(mask, 0) && synchronous(0)) mask |= kSync.of(sync_);
  for (int channel = 0; channel < kPwmChannels; ++channel) {
    if (has_bit(mask, channel)) start(channel);
  }
}

// PWM_DIS: the same group rule. A disabled output shows CPOL.
void Pwm::disable(std::uint32_t mask) {
  if (has_bit(mask, 0) && synchronous(0)) mask |= kSync.of(sync_);
  for (int channel = 0; channel < kPwmChannels; ++channel) {
    if (has_bit(mask, channel)) channels_[index(channel)].enabled = false;
  }
}

// The values of CPRDUPD and CDTYUPD become CPRD and CDTY.
void Pwm::load_updates(int channel) {
  Channel& state = channels_[index(channel)];
  if (state.period_waiting) state.period = state.period_update;
  if (state.duty_waiting) state.duty = state.duty_update;
  state.period_waiting = state.duty_waiting = false;
}

// Asynchronous channels take new values at the end of the period in which they were written.
void Pwm::update_single(int channel, std::uint64_t now) {
  Channel& state = channels_[index(channel)];
  const std::uint64_t begun = now - (now - state.origin) % period_of(channel);
  if ((!state.duty_waiting && !state.period_waiting) || begun < state.update_since) return;
  integrate(channel, begun);
  state.origin = begun;
  load_updates(channel);
}

// The channels of the synchronous group take their new values together, at the end of the period in
// which UPDULOCK was written.
void Pwm::update_group(std::uint64_t now) {
  Channel& zero = channels_[0];
  const std::uint64_t begun = now - (now - zero.origin) % period_of(0);
  integrate_all(begun);
  zero.origin = begun;
  if (!update_unlocked_ || begun < unlocked_since_) return;
  for (int channel = 0; channel < kPwmChannels; ++channel) {
    if (synchronous(channel)) load_updates(channel);
  }
  update_unlocked_ = false;
}

// Runs at period boundaries while something waits for one.
void Pwm::event(std::uint64_t now) {
  for (int channel = 0; channel < kPwmChannels; ++channel) {
    if (!synchronous(channel) && counts(channel)) update_single(channel, now);
  }
  if (synchronous(0) && counts(0)) update_group(now);
  plan();
}

// Schedules event() for the next period boundary at which a channel takes new values.
void Pwm::plan() {
  std::uint64_t when = kNever;
  const std::uint64_t now = system_.now();
  for (int channel = 0; channel < kPwmChannels; ++channel) {
    if (!counts(channel)) continue;
    const Channel& state = channels_[index(channel)];
    const bool waits = synchronous(channel) ? channel == 0 && update_unlocked_
                                            : state.duty_waiting || state.period_waiting;
    if (waits) when = std::min(when, next_period(channel, now));
  }
  system_.scheduler.set(id_, when);
}

// Finds the level again of each pin that shows a PWM output.
void Pwm::outputs_changed() {
  for (const PwmPin& pin : kPwmPins) {
    const PinSetting& setting = pins_.setting(pin.pin);
    if (setting.given_to_peripheral && setting.peripheral_b) pins_.refresh(pin.pin, system_.now());
  }
}

// -- faults -----------------------------------------------------------------------------------

// An edge at a fault pin. With its filter (FFIL) on, it counts only after one cycle.
void Pwm::pin_changed(int fault_input, bool, std::uint64_t now) {
  fault_since_[index(fault_input)] = now;
  if (has_bit(kFfil.of(fault_mode_), fault_input)) {
    system_.scheduler.set(filter_id_, now + 1);
  }
  update_faults();
}

// FFIL drops what does not last a period of the master clock. Inputs 3 to 5 come from inside of the
// chip and are quiet.
void Pwm::filter_faults() {
  const std::uint64_t now = system_.now();
  for (const PwmPin& pin : kFaultPins) {
    const std::uint32_t bit = 1U << pin.signal;
    const bool filtered = has_bit(kFfil.of(fault_mode_), pin.signal);
    if (filtered && now <= fault_since_[index(pin.signal)]) continue;
    const bool high = has_bit(pins_.seen(pin.pin / 32), pin.pin % 32);
    fault_inputs_ = high ? fault_inputs_ | bit : fault_inputs_ & ~bit;
  }
}

// PWM_FSR from the inputs: a fault is present while its input has the level FPOL, and stays with
// FMOD until it is cleared. Channels that become faulted, or no longer are, change their outputs.
void Pwm::update_faults() {
  integrate_all();
  filter_faults();
  const std::uint32_t present = ~(fault_inputs_ ^ kFpol.of(fault_mode_)) & kFaultInputs;
  const std::uint32_t latched = kFmod.of(fault_mode_);
  faults_ = present | (faults_ & latched);
  bool changed = false;
  for (int channel = 0; channel < kPwmChannels; ++channel) {
    const bool now_faulted = faults_active(channel) != 0;
    if (now_faulted == faulted_[index(channel)]) continue;
    changed = true;
    faulted_[index(channel)] = now_faulted;
    if (!now_faulted) continue;
    // The protection resets the counter of the channel it strikes.
    channels_[index(channel)].origin = system_.now();
  }
  if (changed) outputs_changed();
  plan();
}

// PWM_FMR (polarity, latching, filter of the fault inputs), PWM_FCR (clears latched faults),
// PWM_FPV (output levels under a fault) and PWM_FPE1, 2 (default).
void Pwm::write_fault(std::uint32_t offset, std::uint32_t value) {
  switch (offset) {
    case kFmr:
      fault_mode_ = value & kFmrMask;
      break;
    case kFcr:
      faults_ &= ~value;
      break;
    case kFpv:
      fault_values_ = value & kOverrideBits;
      break;
    default:
      for (unsigned i = 0; i < 4; ++i) {
        fault_enable_[(offset - kFpe1) + i] = static_cast<std::uint8_t>(value >> (8 * i));
      }
      break;
  }
  update_faults();
}

// PWM_SCM: bits 0 to 7 say which channels are in the synchronous group.
void Pwm::write_sync_mode(std::uint32_t value) {
  const std::uint32_t joining = kSync.of(value & ~sync_);
  for (int channel = 0; channel < kPwmChannels; ++channel) {
    const bool changes = has_bit(value ^ sync_, channel);
    if (changes && channels_[index(channel)].enabled) {
      misuse(kScm,
             "channel " + std::to_string(channel) + " joins or leaves the group while enabled");
    }
  }
  if (joining != 0 && !has_bit(value, 0))
    misuse(kScm, "channel 0 must belong to the synchronous group");
  if (kUpdm.of(value) != 0) not_modelled(kScm, "UPDM above 0, updates without UPDULOCK");
  sync_ = value & kScmMask;
}

// CDTYUPD or CPRDUPD of a channel: the value acts at the end of its period.
void Pwm::write_update(int channel, std::uint32_t offset, std::uint32_t value) {
  Channel& state = channels_[index(channel)];
  const std::uint32_t reg = register_of(channel, offset);
  if (offset == kCdtyupd) {
    if (value > counter_of(channel).period && !counter_of(channel).period_waiting &&
        state.enabled) {
      misuse(reg, "a duty of " + std::to_string(value) +
                      " is above CPRD = " + std::to_string(counter_of(channel).period));
    }
    state.duty_update = value & kCounterMask;
    state.duty_waiting = true;
    state.update_since = system_.now();
  } else {
    state.period_update = value & kCounterMask;
    state.period_waiting = true;
    state.update_since = system_.now();
  }
  // A channel that does not run uses the value immediately.
  if (synchronous(channel)) return;
  if (!state.enabled) load_updates(channel);
  plan();
}

// A channel's register. The masks keep the bits that the register has.
void Pwm::write_channel(int channel, std::uint32_t offset, std::uint32_t value) {
  Channel& state = channels_[index(channel)];
  const std::uint32_t reg = register_of(channel, offset);
  if (offset == kCdtyupd || offset == kCprdupd) return write_update(channel, offset, value);
  integrate_all();
  if (state.enabled) misuse(reg, "write while the channel is enabled; use the update register");
  switch (offset) {
    case kCmr:
      if ((value & kDeadTime) != 0) not_modelled(reg, "the dead-time generator is not modelled");
      state.mode = value & 0x00070F0FU;  // DTE, DTHI, DTLI, CES, CPOL, CALG, CPRE
      outputs_changed();
      return;
    case kCdty:
      state.duty = value & kCounterMask;
      return;
    case kCprd:
      state.period = value & kCounterMask;
      return;
    default:
      return;
  }
}

// A channel's register. CCNT is computed from the time; centre-aligned counters run up and down.
std::uint32_t Pwm::read_channel(int channel, std::uint32_t offset) const {
  const Channel& state = channels_[index(channel)];
  switch (offset) {
    case kCmr:
      return state.mode;
    case kCdty:
      return state.duty;
    case kCprd:
      return state.period;
    case kCcnt: {
      if (!counts(channel)) return 0;
      const std::uint64_t whole = period_of(channel);
      const std::uint64_t phase = (system_.now() - counter_of(channel).origin) % whole;
      const std::uint64_t up = center(channel) && phase > whole / 2 ? whole - phase : phase;
      return static_cast<std::uint32_t>(up / step_cycles(channel));
    }
    default:
      return 0;
  }
}

// Registers of the controller, and from kChannels on those of the channels.
std::uint32_t Pwm::read(std::uint32_t offset) {
  if (offset >= kChannels)
    return read_channel(static_cast<int>((offset - kChannels) / kChannelBytes),
                        offset % kChannelBytes);
  switch (offset) {
    case kClk:
      return clock_;
    case kSr: {
      std::uint32_t value = 0;
      for (int i = 0; i < kPwmChannels; ++i) value |= channels_[index(i)].enabled ? 1U << i : 0U;
      return value;
    }
    case kScm:
      return sync_;
    case kScuc:
      return update_unlocked_ ? 1U : 0U;
    case kOov:
      return override_value_;
    case kOs:
      return override_;
    case kFmr:
      return fault_mode_;
    case kFsr:
      return fault_inputs_ | (faults_ << 8);
    case kFpv:
      return fault_values_;
    case kFpe1:
    case kFpe2: {
      std::uint32_t value = 0;
      for (unsigned i = 0; i < 4; ++i)
        value |= std::uint32_t{fault_enable_[(offset - kFpe1) + i]} << (8 * i);
      return value;
    }
    default:
      return 0;
  }
}

// PWM_SCUC.UPDULOCK: the group takes its waiting values at the end of the running period.
void Pwm::unlock_update(std::uint32_t value) {
  if ((value & 1U) == 0) return;
  if (!update_unlocked_) unlocked_since_ = system_.now();
  update_unlocked_ = true;
  plan();
}

// What can change an output first counts its high cycles up to now, and then refreshes the pins.
void Pwm::write(std::uint32_t offset, std::uint32_t value) {
  if (offset >= kChannels)
    return write_channel(static_cast<int>((offset - kChannels) / kChannelBytes),
                         offset % kChannelBytes, value);
  if (offset == kScuc) return unlock_update(value);
  integrate_all();
  switch (offset) {
    case kClk:
      clock_ = value & kClkMask;
      break;
    case kEna:
      enable(value);
      break;
    case kDis:
      disable(value);
      break;
    case kScm:
      write_sync_mode(value);
      break;
    case kOov:
      override_value_ = value & kOverrideBits;
      break;
    case kOs:
      override_ = value & kOverrideBits;
      break;
    case kOss:
      override_ |= value & kOverrideBits;
      break;
    case kOsc:
      override_ &= ~value;
      break;
    case kFmr:
    case kFcr:
    case kFpv:
    case kFpe1:
    case kFpe2:
      write_fault(offset, value);
      break;
    default:
      break;
  }
  outputs_changed();
  plan();
}

// Cycles of MCK per count, by CPRE: a power of 2, or clock A (11) or B (12) of PWM_CLK, which
// divides by DIVA or DIVB times a power of 2.
std::uint64_t Pwm::step_cycles(int channel) const {
  const std::uint32_t prescaler = kCpre.of(counter_of(channel).mode);
  if (prescaler <= 10) return std::uint64_t{1} << prescaler;
  const std::uint32_t clock = (prescaler == 11 ? kClockA : kClockB).of(clock_);
  const std::uint32_t divider = kDiv.of(clock);
  return divider == 0 ? 0 : std::uint64_t{divider} << std::min(kPre.of(clock), 10U);
}

// Period in cycles; a centre-aligned counter runs up and down in it.
std::uint64_t Pwm::period_of(int channel) const {
  const std::uint64_t counts = counter_of(channel).period;
  return counts * step_cycles(channel) * (center(channel) ? 2 : 1);
}

std::uint32_t Pwm::period_cycles(int channel) const {
  return static_cast<std::uint32_t>(period_of(channel));
}

// Whether the channel's counter runs.
bool Pwm::counts(int channel) const {
  return channels_[index(channel)].enabled && period_of(channel) != 0 && system_.clocked(clock_id_);
}

// Level of the comparator output. With CPOL = 0 it is low while the counter is below CDTY; with
// CPOL = 1 it is high there.
bool Pwm::comparator_level(int channel, std::uint64_t now) const {
  const Channel& state = channels_[index(channel)];
  const bool start_level = (state.mode & kPolarity) != 0;
  if (!counts(channel)) return start_level;
  const std::uint64_t whole = period_of(channel);
  const std::uint64_t phase = (now - counter_of(channel).origin) % whole;
  // The counter reaches CDTY at `edge`; centre-aligned, it falls below it again at `back`.
  const std::uint64_t edge = std::min(state.duty * step_cycles(channel), whole);
  const std::uint64_t back = center(channel) ? whole - std::min(edge, whole) : whole;
  const bool beyond = phase >= edge && phase < back;
  return beyond != start_level;
}

// Cycles in [from, to) during which the comparator output is high.
std::uint64_t Pwm::comparator_high(int channel, std::uint64_t from, std::uint64_t to) const {
  const Channel& state = channels_[index(channel)];
  const bool start_level = (state.mode & kPolarity) != 0;
  if (!counts(channel)) return start_level ? to - from : 0;
  const std::uint64_t whole = period_of(channel);
  const std::uint64_t edge = std::min(state.duty * step_cycles(channel), whole);
  const std::uint64_t back = center(channel) ? whole - edge : whole;
  const std::uint64_t width = back > edge ? back - edge : 0;
  const std::uint64_t origin = counter_of(channel).origin;
  // Cycles from the origin to `time` with the counter at or above CDTY.
  const auto beyond_until = [&](std::uint64_t time) {
    const std::uint64_t since = time - origin;
    const std::uint64_t phase = since % whole;
    const std::uint64_t part = phase > edge ? std::min(phase - edge, width) : 0;
    return since / whole * width + part;
  };
  const std::uint64_t beyond = beyond_until(to) - beyond_until(from);
  return start_level ? (to - from) - beyond : beyond;
}

std::uint32_t Pwm::faults_active(int channel) const {
  // Synchronous channels take the enable bits of channel 0 instead of their own.
  return faults_ & fault_enable_[synchronous(channel) ? 0 : index(channel)];
}

// Whether a fault or an override (which has less priority) holds the output; `level` is where.
bool Pwm::forced(int channel, bool low_side, bool& level) const {
  const unsigned bit = static_cast<unsigned>(channel) + (low_side ? 16U : 0U);
  if (faults_active(channel) != 0) {
    level = has_bit(fault_values_, bit);
    return true;
  }
  if (has_bit(override_, bit)) {
    level = has_bit(override_value_, bit);
    return true;
  }
  return false;
}

// Level of an output now: PWML is the complement of PWMH.
bool Pwm::level(int signal) const {
  const int channel = signal % kLowSide;
  const bool low_side = signal >= kLowSide;
  bool value = false;
  if (forced(channel, low_side, value)) return value;
  const std::uint32_t mode = channels_[index(channel)].mode;
  const bool inverted = (mode & (low_side ? kInvertLow : kInvertHigh)) != 0;
  return (comparator_level(channel, system_.now()) != low_side) != inverted;
}

// Counts the cycles up to `until` in which each output of the channel was high. Everything that
// changes an output calls this first.
void Pwm::integrate(int channel, std::uint64_t until) {
  Channel& state = channels_[index(channel)];
  if (until <= state.counted) return;
  const std::uint64_t span = until - state.counted;
  const std::uint64_t high = comparator_high(channel, state.counted, until);
  for (const bool low_side : {false, true}) {
    bool value = false;
    const bool inverted = (state.mode & (low_side ? kInvertLow : kInvertHigh)) != 0;
    if (forced(channel, low_side, value)) {
      state.high[low_side] += value ? span : 0;
    } else {
      state.high[low_side] += low_side != inverted ? span - high : high;
    }
  }
  state.counted = until;
}

void Pwm::integrate_all(std::uint64_t until) {
  for (int channel = 0; channel < kPwmChannels; ++channel) integrate(channel, until);
}

std::uint64_t Pwm::high_cycles(int channel, bool low_side) {
  integrate(channel, system_.now());
  return channels_[index(channel)].high[low_side];
}

// See pwm.hpp: the mean over one whole period with the values that act now.
double Pwm::duty(int channel, bool low_side) const {
  bool value = false;
  if (forced(channel, low_side, value)) return value ? 1.0 : 0.0;
  const Channel& state = channels_[index(channel)];
  const bool inverted = (state.mode & (low_side ? kInvertLow : kInvertHigh)) != 0;
  const bool complement = low_side != inverted;
  if (!counts(channel)) return ((state.mode & kPolarity) != 0) != complement ? 1.0 : 0.0;
  const std::uint64_t origin = counter_of(channel).origin;
  const std::uint64_t whole = period_of(channel);
  const std::uint64_t high = comparator_high(channel, origin, origin + whole);
  return static_cast<double>(complement ? whole - high : high) / static_cast<double>(whole);
}

// The cycle after `after` at which the channel's next period begins.
std::uint64_t Pwm::next_period(int channel, std::uint64_t after) const {
  const std::uint64_t whole = period_of(channel);
  const std::uint64_t origin = counter_of(channel).origin;
  if (after < origin) return origin;
  return origin + ((after - origin) / whole + 1) * whole;
}

}  // namespace due_emulator
