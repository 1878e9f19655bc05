// Registers of the PWM controller and the checks on what is written to them. Offsets in hex are
// those of the datasheet (38.7): 0x00 CLK, 0x04 ENA, 0x08 DIS, 0x0C SR, 0x20 SCM, 0x28 SCUC, 0x44
// OOV, 0x48 OS, 0x4C OSS, 0x50 OSC, 0x5C FMR, 0x60 FSR, 0x64 FCR, 0x68 FPV, 0x6C FPE1, 0x70 FPE2; a
// channel's are from 0x200 on, 0x20 each: 0x00 CMR, 0x04 CDTY, 0x08 CDTYUPD, 0x0C CPRD, 0x10
// CPRDUPD, 0x14 CCNT.
#include "chip/pwm.hpp"

namespace due_emulator {

namespace {

constexpr std::uint32_t kOverrideBits = 0x00FF00FFU;
constexpr std::uint32_t kDeadTime = 1U << 16;

}  // namespace

void Pwm::write_fault(std::uint32_t offset, std::uint32_t value) {
  switch (offset) {
    case 0x5C:
      fault_mode_ = value & 0x00FFFFFFU;
      break;
    case 0x64:
      faults_ &= ~value;
      break;
    case 0x68:
      fault_values_ = value & kOverrideBits;
      break;
    default:
      for (unsigned i = 0; i < 4; ++i) {
        fault_enable_[(offset - 0x6C) + i] = static_cast<std::uint8_t>(value >> (8 * i));
      }
      break;
  }
  update_faults();
}

void Pwm::write_sync_mode(std::uint32_t value) {
  const std::uint32_t joining = (value & ~sync_) & 0xFFU;
  for (int channel = 0; channel < kPwmChannels; ++channel) {
    const bool changes = (((value ^ sync_) >> channel) & 1U) != 0;
    if (changes && channels_[index(channel)].enabled) {
      misuse(0x20,
             "channel " + std::to_string(channel) + " joins or leaves the group while enabled");
    }
  }
  if (joining != 0 && (value & 1U) == 0)
    misuse(0x20, "channel 0 must belong to the synchronous group");
  if (((value >> 16) & 3U) != 0) not_modelled(0x20, "UPDM above 0, updates without UPDULOCK");
  sync_ = value & 0x00F000FFU;
}

// CDTYUPD or CPRDUPD of a channel: the value acts at the end of its period.
void Pwm::write_update(int channel, std::uint32_t offset, std::uint32_t value) {
  Channel& own = channels_[index(channel)];
  const std::uint32_t reg = 0x200U + 32U * static_cast<std::uint32_t>(channel) + offset;
  if (offset == 0x08) {
    if (value > counter_of(channel).period && !counter_of(channel).period_waiting && own.enabled) {
      misuse(reg, "a duty of " + std::to_string(value) +
                      " is above CPRD = " + std::to_string(counter_of(channel).period));
    }
    own.duty_update = value & 0xFFFFFFU;
    own.duty_waiting = true;
    own.update_since = system_.now();
  } else {
    own.period_update = value & 0xFFFFFFU;
    own.period_waiting = true;
    own.update_since = system_.now();
  }
  // A channel that does not run uses the value immediately.
  if (synchronous(channel)) return;
  if (!own.enabled) load_updates(channel);
  plan();
}

// A channel's register. The masks keep the bits that the register has.
void Pwm::write_channel(int channel, std::uint32_t offset, std::uint32_t value) {
  Channel& own = channels_[index(channel)];
  const std::uint32_t reg = 0x200U + 32U * static_cast<std::uint32_t>(channel) + offset;
  if (offset == 0x08 || offset == 0x10) return write_update(channel, offset, value);
  integrate_all();
  if (own.enabled) misuse(reg, "write while the channel is enabled; use the update register");
  switch (offset) {
    case 0x00:
      if ((value & kDeadTime) != 0) not_modelled(reg, "the dead-time generator is not modelled");
      own.mode = value & 0x00070F0FU;
      outputs_changed();
      return;
    case 0x04:
      own.duty = value & 0xFFFFFFU;
      return;
    case 0x0C:
      own.period = value & 0xFFFFFFU;
      return;
    default:
      return;
  }
}

std::uint32_t Pwm::read_channel(int channel, std::uint32_t offset) const {
  const Channel& own = channels_[index(channel)];
  switch (offset) {
    case 0x00:
      return own.mode;
    case 0x04:
      return own.duty;
    case 0x0C:
      return own.period;
    case 0x14: {
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

std::uint32_t Pwm::read(std::uint32_t offset) {
  if (offset >= 0x200) return read_channel(static_cast<int>((offset - 0x200) / 32), offset % 32);
  switch (offset) {
    case 0x00:
      return clock_;
    case 0x0C: {
      std::uint32_t value = 0;
      for (int i = 0; i < kPwmChannels; ++i) value |= channels_[index(i)].enabled ? 1U << i : 0U;
      return value;
    }
    case 0x20:
      return sync_;
    case 0x28:
      return update_unlocked_ ? 1U : 0U;
    case 0x44:
      return override_value_;
    case 0x48:
      return override_;
    case 0x5C:
      return fault_mode_;
    case 0x60:
      return fault_inputs_ | (faults_ << 8);
    case 0x68:
      return fault_values_;
    case 0x6C:
    case 0x70: {
      std::uint32_t value = 0;
      for (unsigned i = 0; i < 4; ++i)
        value |= std::uint32_t{fault_enable_[(offset - 0x6C) + i]} << (8 * i);
      return value;
    }
    default:
      return 0;
  }
}

// Nothing changes before the period that runs has ended.
void Pwm::unlock_update(std::uint32_t value) {
  if ((value & 1U) == 0) return;
  if (!update_unlocked_) unlocked_since_ = system_.now();
  update_unlocked_ = true;
  plan();
}

void Pwm::write(std::uint32_t offset, std::uint32_t value) {
  if (offset >= 0x200)
    return write_channel(static_cast<int>((offset - 0x200) / 32), offset % 32, value);
  if (offset == 0x28) return unlock_update(value);
  integrate_all();
  switch (offset) {
    case 0x00:
      clock_ = value & 0x0FFF0FFFU;
      break;
    case 0x04:
      enable(value);
      break;
    case 0x08:
      disable(value);
      break;
    case 0x20:
      write_sync_mode(value);
      break;
    case 0x44:
      override_value_ = value & kOverrideBits;
      break;
    case 0x48:
      override_ = value & kOverrideBits;
      break;
    case 0x4C:
      override_ |= value & kOverrideBits;
      break;
    case 0x50:
      override_ &= ~value;
      break;
    case 0x5C:
    case 0x64:
    case 0x68:
    case 0x6C:
    case 0x70:
      write_fault(offset, value);
      break;
    default:
      break;
  }
  outputs_changed();
  plan();
}

}  // namespace due_emulator
