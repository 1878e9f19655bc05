// PWM controller (section 38): eight channels with double-buffered updates, a synchronous group,
// output override and fault protection.
//
// PWML is the complement of PWMH, and a channel that is disabled shows CPOL: with CPOL = 0 its PWML
// is high.
#pragma once

#include <array>

#include "chip/peripheral.hpp"
#include "chip/pins.hpp"

namespace due_emulator {

inline constexpr int kPwmChannels = 8;

class Pwm final : public Peripheral, public PinDriver, public PinListener {
 public:
  // Signals for PinDriver: channel, plus 8 for the low side. For PinListener: fault input.
  static constexpr int kLowSide = 8;
  // Signal that a pin can give as peripheral B; -1 if it is no PWM output.
  static int signal_at(int pin);

  Pwm(System& system, Pins& pins);

  void reset() override;
  void event(std::uint64_t now) override;
  bool drives(int) const override { return true; }
  bool level(int signal) const override;
  void pin_changed(int fault_input, bool level, std::uint64_t now) override;

  // Cycles that an output has been high since reset; differences give the mean duty.
  std::uint64_t high_cycles(int channel, bool low_side);
  // Fraction of the running period that an output is high, overrides and faults included.
  double duty(int channel, bool low_side) const;
  std::uint32_t period_cycles(int channel) const;
  std::uint32_t active_duty(int channel) const { return channels_[index(channel)].duty; }

 protected:
  std::uint32_t read(std::uint32_t offset) override;
  void write(std::uint32_t offset, std::uint32_t value) override;
  std::uint32_t from_outside(std::uint32_t offset) const override {
    return offset == 0x60 ? ~0U : 0;  // FSR
  }

 private:
  struct Channel {
    std::uint32_t mode = 0;           // CMR
    std::uint32_t duty = 0;           // CDTY
    std::uint32_t period = 0;         // CPRD
    std::uint32_t duty_update = 0;    // CDTYUPD
    std::uint32_t period_update = 0;  // CPRDUPD
    bool duty_waiting = false;
    bool period_waiting = false;
    bool enabled = false;
    std::uint64_t origin = 0;        // cycle at which a period began
    std::uint64_t counted = 0;       // cycle up to which `high` is right
    std::uint64_t update_since = 0;  // when the waiting values were written
    std::uint64_t high[2] = {0, 0};  // PWMH, PWML
  };

  static std::size_t index(int channel) { return static_cast<std::size_t>(channel); }
  // Any synchronous channel makes channel 0 one.
  bool synchronous(int channel) const {
    return ((sync_ >> channel) & 1U) != 0 || (channel == 0 && (sync_ & 0xFFU) != 0);
  }
  // The channel whose counter, clock and period this channel uses: in the group, channel 0.
  const Channel& counter_of(int channel) const {
    return channels_[synchronous(channel) ? 0 : index(channel)];
  }
  std::uint64_t step_cycles(int channel) const;
  std::uint64_t period_of(int channel) const;
  // CMR.CALG: centre-aligned.
  bool center(int channel) const { return (counter_of(channel).mode & (1U << 8)) != 0; }
  bool counts(int channel) const;
  bool forced(int channel, bool low_side, bool& level) const;
  bool comparator_level(int channel, std::uint64_t now) const;
  std::uint64_t comparator_high(int channel, std::uint64_t from, std::uint64_t to) const;
  std::uint64_t next_period(int channel, std::uint64_t after) const;
  void integrate(int channel, std::uint64_t until);
  void integrate_all() { integrate_all(system_.now()); }
  void integrate_all(std::uint64_t until);
  void start(int channel);
  void enable(std::uint32_t mask);
  void disable(std::uint32_t mask);
  void load_updates(int channel);
  void update_single(int channel, std::uint64_t now);
  void update_group(std::uint64_t now);
  void update_faults();
  void filter_faults();

  // Looks again when a filtered fault input has stood for a period of the master clock.
  struct FaultFilter final : EventSink {
    explicit FaultFilter(Pwm& pwm) : owner(pwm) {}
    void event(std::uint64_t) override { owner.update_faults(); }
    Pwm& owner;
  };
  std::uint32_t faults_active(int channel) const;
  void write_channel(int channel, std::uint32_t offset, std::uint32_t value);
  std::uint32_t read_channel(int channel, std::uint32_t offset) const;
  void write_update(int channel, std::uint32_t offset, std::uint32_t value);
  void write_sync_mode(std::uint32_t value);
  void unlock_update(std::uint32_t value);
  void write_fault(std::uint32_t offset, std::uint32_t value);
  void plan();
  void outputs_changed();

  Pins& pins_;
  Scheduler::Id id_;
  FaultFilter filter_{*this};
  Scheduler::Id filter_id_;
  std::array<Channel, kPwmChannels> channels_{};
  std::uint32_t clock_ = 0;       // CLK
  std::uint32_t sync_ = 0;        // SCM
  bool update_unlocked_ = false;  // SCUC.UPDULOCK
  std::uint64_t unlocked_since_ = 0;
  std::uint32_t override_value_ = 0;  // OOV
  std::uint32_t override_ = 0;        // OS
  std::uint32_t fault_mode_ = 0;      // FMR
  std::uint32_t fault_inputs_ = 0;    // behind the filters
  std::array<std::uint64_t, 3> fault_since_{};
  std::uint32_t faults_ = 0;        // FSR.FS: active, latched ones included
  std::uint32_t fault_values_ = 0;  // FPV
  std::array<std::uint8_t, kPwmChannels> fault_enable_{};
  std::array<bool, kPwmChannels> faulted_{};
};

}  // namespace due_emulator
