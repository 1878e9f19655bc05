// Registers of the PWM controller and the checks on what is written to them; see pwm.hpp. Names and
// offsets are those of the datasheet (38.7).
#include "chip/pwm.hpp"

namespace due_emulator {

namespace {

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

}  // namespace

// PWM_FMR (polarity, latching, filter of the fault inputs), PWM_FCR (clears latched faults),
// PWM_FPV (output levels under a fault) and PWM_FPE1, 2 (default).
void Pwm::write_fault(std::uint32_t offset, std::uint32_t value) {
  switch (offset) {
    case kFmr:
      fault_mode_ = value & 0x00FFFFFFU;  // FPOL, FMOD, FFIL
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
  const std::uint32_t joining = (value & ~sync_) & 0xFFU;
  for (int channel = 0; channel < kPwmChannels; ++channel) {
    const bool changes = (((value ^ sync_) >> channel) & 1U) != 0;
    if (changes && channels_[index(channel)].enabled) {
      misuse(kScm,
             "channel " + std::to_string(channel) + " joins or leaves the group while enabled");
    }
  }
  if (joining != 0 && (value & 1U) == 0)
    misuse(kScm, "channel 0 must belong to the synchronous group");
  if (((value >> 16) & 3U) != 0) not_modelled(kScm, "UPDM above 0, updates without UPDULOCK");
  sync_ = value & 0x00F000FFU;  // SYNC, PTRM, PTRCS
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
      clock_ = value & 0x0FFF0FFFU;  // PREB, DIVB, PREA, DIVA
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

}  // namespace due_emulator
