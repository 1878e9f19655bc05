// Channels, synchronous updates, overrides and faults of the PWM controller; see pwm.hpp.
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
  if ((mask & 1U) != 0 && synchronous(0)) mask |= sync_ & 0xFFU;
  for (int channel = 0; channel < kPwmChannels; ++channel) {
    if (((mask >> channel) & 1U) != 0) start(channel);
  }
}

// PWM_DIS: the same group rule. A disabled output shows CPOL.
void Pwm::disable(std::uint32_t mask) {
  if ((mask & 1U) != 0 && synchronous(0)) mask |= sync_ & 0xFFU;
  for (int channel = 0; channel < kPwmChannels; ++channel) {
    if (((mask >> channel) & 1U) != 0) channels_[index(channel)].enabled = false;
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
  if (((fault_mode_ >> (16 + fault_input)) & 1U) != 0) {
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
    const bool filtered = ((fault_mode_ >> 16) & bit) != 0;
    if (filtered && now <= fault_since_[index(pin.signal)]) continue;
    const bool high = ((pins_.seen(pin.pin / 32) >> (pin.pin % 32)) & 1U) != 0;
    fault_inputs_ = high ? fault_inputs_ | bit : fault_inputs_ & ~bit;
  }
}

// PWM_FSR from the inputs: a fault is present while its input has the level FPOL, and stays with
// FMOD until it is cleared. Channels that become faulted, or no longer are, change their outputs.
void Pwm::update_faults() {
  integrate_all();
  filter_faults();
  const std::uint32_t polarity = fault_mode_ & 0xFFU;
  const std::uint32_t present = ~(fault_inputs_ ^ polarity) & 0x3FU;  // six inputs
  const std::uint32_t latched = (fault_mode_ >> 8) & 0xFFU;
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

}  // namespace due_emulator
