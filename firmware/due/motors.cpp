#include "motors.hpp"

#include <cstdint>

#include "clock.hpp"
#include "pins.hpp"
#include "registers.hpp"

namespace heli::due::motors {
namespace {

constexpr unsigned kFrontForward = 4;
constexpr unsigned kFrontReverse = 5;
constexpr unsigned kBackForward = 6;
constexpr unsigned kBackReverse = 7;
constexpr std::uint32_t kChannelMask = 0xF0;
// Synchronous channels take clock, period, alignment and fault enables from channel 0, which is
// therefore always one of them; its own pins are not used.
constexpr std::uint32_t kGroup = kChannelMask | 1U;
constexpr unsigned kChannels[] = {0, kFrontForward, kFrontReverse, kBackForward, kBackReverse};

constexpr std::uint32_t kPeriod = kDutyFull;

// With CPOL = 1 the output PWMH is high while the counter is below CDTY and while the channel is
// disabled; PWML, its complement, is then low. CDTY = period - duty makes PWML high for duty.
constexpr std::uint32_t kMode = PWM_CMR_CPRE_MCK | PWM_CMR_CALG | PWM_CMR_CPOL;

// PWMFI2 is fault input 2 of the SAM3X.
constexpr std::uint32_t kStopInput = bit(2);
// Which level stops: high, so that a normally closed switch to ground stops when it is pressed,
// when its wire breaks and when nothing is connected. Change it only together with the wiring.
constexpr bool kStopIsHigh = true;

// Bits of the PWML outputs in the override registers.
constexpr std::uint32_t kOverride = kChannelMask << 16U;

constexpr std::uint32_t kPwmPins = pins::kFrontForward.mask() | pins::kFrontReverse.mask() |
                                   pins::kBackForward.mask() | pins::kBackReverse.mask();
constexpr std::uint32_t kEnablesA =
    pins::kFrontReverseEnable.mask() | pins::kBackForwardEnable.mask();
constexpr std::uint32_t kEnablesB = pins::kFrontForwardEnable.mask();
constexpr std::uint32_t kEnablesD = pins::kBackReverseEnable.mask();

bool enabled;

void drive_low(At<Pio> port, std::uint32_t mask) {
  port->PIO_CODR.write(mask);
  port->PIO_OER.write(mask);
  port->PIO_PER.write(mask);
  port->PIO_PUDR.write(mask);
}

void disable_drivers() {
  PIOA->PIO_CODR.write(kEnablesA);
  PIOB->PIO_CODR.write(kEnablesB);
  PIOD->PIO_CODR.write(kEnablesD);
}

void set_duty(unsigned channel, std::int32_t duty) {
  PWM->PWM_CH_NUM[channel].PWM_CDTYUPD.write(kPeriod - static_cast<std::uint32_t>(duty));
}

}  // namespace

void hold_off() {
  pins::clock_all_ports();
  drive_low(PIOA, kEnablesA);
  drive_low(PIOB, kEnablesB);
  drive_low(PIOD, kEnablesD);
  drive_low(PIOC, kPwmPins);
}

void start() {
  PMC->PMC_PCER1.write(bit(ID_PWM - 32));
  PWM->PWM_OOV.write(0);
  PWM->PWM_OSS.write(kOverride);

  PWM->PWM_SCM.write(kGroup | PWM_SCM_UPDM_MODE0);
  for (const unsigned channel : kChannels) {
    PwmChannel& registers = PWM->PWM_CH_NUM[channel];
    registers.PWM_CMR.write(kMode);
    registers.PWM_CPRD.write(kPeriod);
    registers.PWM_CDTY.write(kPeriod);
  }

  // Latched (FMOD) and filtered, so that a bouncing switch stops once and for good. FPV = 0: low.
  PWM->PWM_FMR.write(PWM_FMR_FPOL(kStopIsHigh ? kStopInput : 0U) | PWM_FMR_FMOD(kStopInput) |
                     PWM_FMR_FFIL(kStopInput));
  PWM->PWM_FPV.write(0);
  PWM->PWM_FPE1.write(kStopInput);
  PWM->PWM_FPE2.write(kStopInput * 0x01010101U);
  PIOD->PIO_PUER.write(pins::kHardwareStop.mask());
  pins::to_peripheral_b(PIOD, pins::kHardwareStop.mask());
  // What the input seemed to be before its polarity was known.
  PWM->PWM_FCR.write(PWM_FCR_FCLR(kStopInput));

  PWM->PWM_ENA.write(kGroup);
  pins::to_peripheral_b(PIOC, kPwmPins);
}

void write(const MotorCommand& command) {
  if (!command.enable) {
    disable_drivers();
    PWM->PWM_OSS.write(kOverride);
  }
  const std::int32_t front = command.enable ? command.front_duty : 0;
  const std::int32_t back = command.enable ? command.back_duty : 0;
  set_duty(kFrontForward, front > 0 ? front : 0);
  set_duty(kFrontReverse, front < 0 ? -front : 0);
  set_duty(kBackForward, back > 0 ? back : 0);
  set_duty(kBackReverse, back < 0 ? -back : 0);
  PWM->PWM_SCUC.write(PWM_SCUC_UPDULOCK);

  if (command.enable && !enabled) {
    PWM->PWM_OSC.write(kOverride);
    PIOA->PIO_SODR.write(kEnablesA);
    PIOB->PIO_SODR.write(kEnablesB);
    PIOD->PIO_SODR.write(kEnablesD);
  }
  enabled = command.enable;
}

bool hardware_stop() {
  const std::uint32_t status = PWM->PWM_FSR.read();
  const bool active = (PWM_FSR_FS.of(status) & kStopInput) != 0U;
  const bool high = (PWM_FSR_FIV.of(status) & kStopInput) != 0U;
  const bool pressed = high == kStopIsHigh;
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
