// PWM channels, driver enables and the hardware stop; see motors.hpp for the context of each call.
#include "motors.hpp"

#include <cstdint>
#include <wiring.hpp>

#include "drivers.hpp"
#include "pins.hpp"
#include "registers.hpp"

namespace heli::due::motors {
namespace {

constexpr std::uint32_t kChannelMask = 0xF0;  // channels 4 to 7, see wiring.hpp
// Synchronous channels take clock, period, alignment and fault enables from channel 0, which is
// therefore always one of them; its own pins are not used.
constexpr std::uint32_t kGroup = kChannelMask | 1U;
constexpr unsigned kChannels[] = {0, wiring::kFrontForwardChannel, wiring::kFrontReverseChannel,
                                  wiring::kBackForwardChannel, wiring::kBackReverseChannel};

constexpr std::uint32_t kPeriod = kDutyFull;

// With CPOL = 1 the output PWMH is high while the counter is below CDTY and while the channel is
// disabled; PWML, its complement, is then low. CDTY = period - duty makes PWML high for duty.
constexpr std::uint32_t kMode = PWM_CMR_CPRE_MCK | PWM_CMR_CALG | PWM_CMR_CPOL;

// PWMFI2 is fault input 2 of the SAM3X.
constexpr std::uint32_t kStopInput = bit(2);
// Bits of the PWML outputs in the override registers.
constexpr std::uint32_t kOverride = kChannelMask << 16U;

// Override and fault levels that switch a bridge off.
constexpr std::uint32_t kOffLevels = wiring::kPwmInverted ? kOverride : 0U;

constexpr std::uint32_t kPwmPins = wiring::kFrontForward.mask() | wiring::kFrontReverse.mask() |
                                   wiring::kBackForward.mask() | wiring::kBackReverse.mask();

constexpr std::uint32_t enables_on(At<Pio> port) {
  return wiring::kFrontForwardEnable.mask_on(port) | wiring::kFrontReverseEnable.mask_on(port) |
         wiring::kBackForwardEnable.mask_on(port) | wiring::kBackReverseEnable.mask_on(port);
}
constexpr std::uint32_t kEnablesA = enables_on(PIOA);
constexpr std::uint32_t kEnablesB = enables_on(PIOB);
constexpr std::uint32_t kEnablesC = enables_on(PIOC);
constexpr std::uint32_t kEnablesD = enables_on(PIOD);

bool enabled;  // by the last write(): the drivers are on

// Sets output pins of a port.
void set_level(At<Pio> port, std::uint32_t mask, bool high) {
  if (high) {
    port->PIO_SODR.write(mask);
  } else {
    port->PIO_CODR.write(mask);
  }
}

// On a port without an enable nothing is written.
template <bool kOn>
void set_enables() {
  constexpr bool kHigh = kOn != wiring::kEnableInverted;
  if constexpr (kEnablesA != 0U) set_level(PIOA, kEnablesA, kHigh);
  if constexpr (kEnablesB != 0U) set_level(PIOB, kEnablesB, kHigh);
  if constexpr (kEnablesC != 0U) set_level(PIOC, kEnablesC, kHigh);
  if constexpr (kEnablesD != 0U) set_level(PIOD, kEnablesD, kHigh);
}

// Makes pins outputs with this level, without pull-up.
void drive_output(At<Pio> port, std::uint32_t mask, bool high) {
  set_level(port, mask, high);
  port->PIO_OER.write(mask);
  port->PIO_PER.write(mask);
  port->PIO_PUDR.write(mask);
}

void disable_drivers() { set_enables<false>(); }

// The duty in steps, 0 to kPeriod; it acts from the next period on.
void set_duty(unsigned channel, std::int32_t duty) {
  const auto steps = static_cast<std::uint32_t>(duty);
  PWM->PWM_CH_NUM[channel].PWM_CDTYUPD.write(wiring::kPwmInverted ? steps : kPeriod - steps);
}

}  // namespace

void hold_off() {
  pins::clock_all_ports();
  constexpr bool kOff = wiring::kEnableInverted;
  if constexpr (kEnablesA != 0U) drive_output(PIOA, kEnablesA, kOff);
  if constexpr (kEnablesB != 0U) drive_output(PIOB, kEnablesB, kOff);
  if constexpr (kEnablesC != 0U) drive_output(PIOC, kEnablesC, kOff);
  if constexpr (kEnablesD != 0U) drive_output(PIOD, kEnablesD, kOff);
  drive_output(PIOC, kPwmPins, wiring::kPwmInverted);
}

void start() {
  // The override keeps the outputs off while the channels are set up.
  PMC->PMC_PCER1.write(bit(ID_PWM - 32));
  PWM->PWM_OOV.write(kOffLevels);
  PWM->PWM_OSS.write(kOverride);

  PWM->PWM_SCM.write(kGroup | PWM_SCM_UPDM_MODE0);
  for (const unsigned channel : kChannels) {
    PwmChannel& registers = PWM->PWM_CH_NUM[channel];
    registers.PWM_CMR.write(kMode);
    registers.PWM_CPRD.write(kPeriod);
    registers.PWM_CDTY.write(wiring::kPwmInverted ? 0U : kPeriod);
  }

  // Latched (FMOD) and filtered, so that a bouncing switch stops once and for good. FPV: off.
  PWM->PWM_FMR.write(PWM_FMR_FPOL(wiring::kStopIsHigh ? kStopInput : 0U) |
                     PWM_FMR_FMOD(kStopInput) | PWM_FMR_FFIL(kStopInput));
  PWM->PWM_FPV.write(kOffLevels);
  PWM->PWM_FPE1.write(kStopInput);
  PWM->PWM_FPE2.write(kStopInput * 0x01010101U);
  PIOD->PIO_PUER.write(pins::kHardwareStop.mask());
  pins::to_peripheral_b(PIOD, pins::kHardwareStop.mask());
  // Clears a stop that was latched before the input's polarity was set.
  PWM->PWM_FCR.write(PWM_FCR_FCLR(kStopInput));

  PWM->PWM_ENA.write(kGroup);
  pins::to_peripheral_b(PIOC, kPwmPins);
}

void write(const MotorCommand& command) {
  // Off: drivers and outputs first, then the duties.
  if (!command.enable) {
    disable_drivers();
    PWM->PWM_OSS.write(kOverride);
  }
  const std::int32_t front = command.enable ? command.front_duty : 0;
  const std::int32_t back = command.enable ? command.back_duty : 0;
  set_duty(wiring::kFrontForwardChannel, front > 0 ? front : 0);
  set_duty(wiring::kFrontReverseChannel, front < 0 ? -front : 0);
  set_duty(wiring::kBackForwardChannel, back > 0 ? back : 0);
  set_duty(wiring::kBackReverseChannel, back < 0 ? -back : 0);
  PWM->PWM_SCUC.write(PWM_SCUC_UPDULOCK);

  // On: the duties are written before the outputs and drivers are released.
  if (command.enable && !enabled) {
    PWM->PWM_OSC.write(kOverride);
    set_enables<true>();
  }
  enabled = command.enable;
}

bool hardware_stop() {
  const std::uint32_t status = PWM->PWM_FSR.read();
  const bool active = (PWM_FSR_FS.of(status) & kStopInput) != 0U;
  const bool high = (PWM_FSR_FIV.of(status) & kStopInput) != 0U;
  const bool pressed = high == wiring::kStopIsHigh;
  // The latch is cleared only when the input is released and the motors are off.
  if (active && !pressed && !enabled) PWM->PWM_FCR.write(PWM_FCR_FCLR(kStopInput));
  return active || pressed;
}

void cut() {
  pins::clock_all_ports();
  disable_drivers();
  PMC->PMC_PCER1.write(bit(ID_PWM - 32));
  PWM->PWM_OSS.write(kOverride);
}

}  // namespace heli::due::motors
