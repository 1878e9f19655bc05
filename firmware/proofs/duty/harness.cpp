// From a law's voltages to the half bridges: the duty, and what the Due's registers get.
#include "any.hpp"
#include "control/fixed.hpp"

namespace heli::control {

// Contract: the product of a voltage and a factor is any number. The solver cannot multiply
// cheaply.
template <>
Whole product<0, 24, 20>(Quantity, Gain) {
  return proofs::any<Whole>();
}

}  // namespace heli::control

#include "conversion.cpp"
#include "duty/invariant.hpp"
#include "params/params.hpp"

// Registers are variables here, not addresses.
namespace heli::proofs {
template <class Block>
Block register_block(unsigned long address);
}
#define reinterpret_cast ::heli::proofs::register_block
#define volatile
#include "../due/registers.hpp"
#undef reinterpret_cast

namespace {
heli::due::Pio pio[4];
heli::due::Pwm pwm;
heli::due::Pmc pmc;
}  // namespace

namespace heli::proofs {
template <>
due::Pio* register_block<due::Pio*>(unsigned long address) {
  return &pio[(address - 0x400E0E00U) / 0x200U];
}
template <>
due::Pwm* register_block<due::Pwm*>(unsigned long) {
  return &pwm;
}
template <>
due::Pmc* register_block<due::Pmc*>(unsigned long) {
  return &pmc;
}
}  // namespace heli::proofs

#include "../due/motors.cpp"
#undef volatile

using heli::control::Quantity;
using heli::proofs::any;
using heli::proofs::holds;

namespace {

constexpr std::int32_t kMostDuty = 10000;  // of any board: board.hpp

bool within(std::int32_t duty, std::int32_t full) { return -full <= duty && duty <= full; }

}  // namespace

// The limits of a motor's duty, from any parameters.
void step_conversion() {
  const auto params = any<heli::params::Params>();
  const auto full = any<std::int16_t>();
  ASSUME(1 <= full && full <= kMostDuty);
  const heli::MotorConversion motor = heli::motor_conversion_of(params, any<float>(), full);
  CLAIM(holds(motor, full), "the limits are within full duty");
}

// From two voltages to the duties of a command.
void step_command() {
  const auto conversion = any<heli::Conversion>();
  const auto full = any<std::int32_t>();
  ASSUME(1 <= full && full <= kMostDuty);
  ASSUME(holds(conversion.front, full) && holds(conversion.back, full));
  const bool enable = any<bool>();

  const heli::MotorCommand command =
      heli::motor_command(enable, any<Quantity>(), any<Quantity>(), conversion);

  CLAIM(within(command.front_duty, full) && within(command.back_duty, full),
        "the duties are within full duty");
  CLAIM(command.enable == enable, "the bridges are on only if asked for");
  CLAIM(enable || (command.front_duty == 0 && command.back_duty == 0), "off is duty 0");
}

// From a command to the registers of PWM and PIO.
void step_write() {
  using namespace heli::due::motors;
  const auto command = any<heli::MotorCommand>();
  ASSUME(within(command.front_duty, kDutyFull) && within(command.back_duty, kDutyFull));
  heli::due::motors::enabled = any<bool>();
  for (heli::due::Pio& port : pio) {
    port.PIO_SODR.value_ = 0U;
    port.PIO_CODR.value_ = 0U;
  }
  pwm.PWM_OSC.value_ = 0U;
  pwm.PWM_OSS.value_ = 0U;

  write(command);

  // A half bridge is high from CDTY to the end of its period. Front forward and reverse, back the
  // same.
  std::uint32_t duty[4];
  for (unsigned k = 0; k < 4; ++k) {
    const std::uint32_t low =
        pwm.PWM_CH_NUM[heli::due::wiring::kFrontForwardChannel + k].PWM_CDTYUPD.value_;
    CLAIM(low <= kPeriod, "a duty is within the period");
    duty[k] = kPeriod - low;
  }
  CLAIM(duty[0] == 0U || duty[1] == 0U, "the front bridge never drives both ways");
  CLAIM(duty[2] == 0U || duty[3] == 0U, "the back bridge never drives both ways");
  const std::int32_t front =
      static_cast<std::int32_t>(duty[0]) - static_cast<std::int32_t>(duty[1]);
  const std::int32_t back = static_cast<std::int32_t>(duty[2]) - static_cast<std::int32_t>(duty[3]);
  CLAIM(!command.enable || (front == command.front_duty && back == command.back_duty),
        "each bridge gets its duty");
  if (!command.enable) {
    CLAIM(front == 0 && back == 0, "off is duty 0");
    CLAIM(pwm.PWM_OSS.value_ == kOverride && pwm.PWM_OSC.value_ == 0U,
          "off forces the outputs low");
    CLAIM((pio[0].PIO_CODR.value_ & kEnablesA) == kEnablesA &&
              (pio[1].PIO_CODR.value_ & kEnablesB) == kEnablesB &&
              (pio[3].PIO_CODR.value_ & kEnablesD) == kEnablesD,
          "off takes all four enables away");
    CLAIM(pio[0].PIO_SODR.value_ == 0U && pio[1].PIO_SODR.value_ == 0U &&
              pio[3].PIO_SODR.value_ == 0U,
          "off gives no enable");
  }
}
