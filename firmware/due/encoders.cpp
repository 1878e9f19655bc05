#include "encoders.hpp"

#include <cstdint>

#include "cortex_m3.hpp"
#include "pins.hpp"
#include "priorities.hpp"
#include "registers.hpp"
#include "vectors.hpp"

namespace heli::due::encoders {
namespace {

// Pulses shorter than 64 periods of the master clock (0.76 us) are noise: even at 200,000 edges a
// second edges are 5 us apart.
constexpr std::uint32_t kFilter = TC_BMR_FILTER | TC_BMR_MAXFILT(63);

// Both edges of both lines: four counts a pulse.
constexpr std::uint32_t kDecoder = TC_BMR_QDEN | TC_BMR_POSEN | TC_BMR_EDGPHA | kFilter;

// The datasheet asks for the external trigger on TIOA, which the decoder replaces by its index
// input: D10 and A6 are those inputs and must stay unconnected, an edge there would clear the
// count.
constexpr std::uint32_t kPosition = TC_CMR_TCCLKS_XC0 | TC_CMR_ETRGEDG_RISING | TC_CMR_ABETRG;

constexpr std::uint32_t kTravelMask = pins::kTravelA.mask() | pins::kTravelB.mask();
static_assert(pins::kTravelA.number == 0 && pins::kTravelB.number == 1 && kTravelMask == 3U,
              "the masked port is the index of the transition table");

// Edges of travel that are served in a tick: twice what comes at 200,000 a second, and less than a
// third of the tick, so that noise on the lines starves neither the tick nor the idle loop.
constexpr std::uint32_t kMaxEdges = 400;

// Steps by (state before, state now), a state being B then A; A leads B upwards. kIllegal: both
// lines changed at once, an edge was missed.
constexpr std::int8_t kIllegal = 2;
constexpr std::int8_t kSteps[16] = {
    0,        1,        -1,       kIllegal,  // from 00
    -1,       0,        kIllegal, 1,         // from 01
    1,        kIllegal, 0,        -1,        // from 10
    kIllegal, -1,       1,        0,         // from 11
};

// Written by the encoder interrupt, read by the tick; each is one aligned word.
volatile std::int32_t travel_count;
volatile std::uint32_t travel_illegal;
volatile std::uint32_t travel_edges;  // since the tick looked
volatile bool travel_overloaded;
std::uint32_t travel_state;

std::uint32_t decoder_errors[2];

// A trigger clears the counter at the next edge of its clock, which is not counted (datasheet,
// 36.6.2): an edge of the master clock takes it here, or a step of the decoder would be lost. Where
// the count then begins is as good as any: the core takes its zero at its first tick.
void start_decoder(At<Tc> tc) {
  tc->TC_BMR.write(kDecoder);
  tc->TC_CHANNEL[0].TC_CMR.write(0);
  tc->TC_CHANNEL[0].TC_CCR.write(TC_CCR_CLKEN | TC_CCR_SWTRG);
  static_cast<void>(tc->TC_CHANNEL[0].TC_CV.read());
  tc->TC_CHANNEL[0].TC_CMR.write(kPosition);
}

std::uint32_t errors(At<Tc> tc, std::uint32_t& count) {
  if ((tc->TC_QISR.read() & TC_QISR_QERR) != 0U) ++count;
  return count;
}

// How many edges used up the budget, 0 if it was enough; travel gets a new one.
std::uint32_t renew_budget() {
  travel_edges = 0;
  if (!travel_overloaded) return 0;
  travel_overloaded = false;
  PIOD->PIO_IER.write(kTravelMask);
  return kMaxEdges;
}

}  // namespace

void start() {
  PMC->PMC_PCER0.write(bit(ID_TC0));
  PMC->PMC_PCER1.write(bit(ID_TC6 - 32));
  pins::to_peripheral_b(PIOB, pins::kElevationA.mask() | pins::kElevationB.mask());
  pins::to_peripheral_b(PIOC, pins::kPitchA.mask() | pins::kPitchB.mask());
  start_decoder(TC0);
  start_decoder(TC2);

  PIOD->PIO_ODR.write(kTravelMask);
  PIOD->PIO_PER.write(kTravelMask);
  travel_state = PIOD->PIO_PDSR.read() & kTravelMask;
  // After reset a pin's interrupt comes at both edges.
  PIOD->PIO_IER.write(kTravelMask);
  enable_interrupt(ID_PIOD, kEncoderPriority);
}

EncoderReading read() {
  EncoderReading reading{};
  reading.count[kElevation] = static_cast<std::int32_t>(TC0->TC_CHANNEL[0].TC_CV.read());
  reading.count[kPitch] = static_cast<std::int32_t>(TC2->TC_CHANNEL[0].TC_CV.read());
  reading.count[kTravel] = travel_count;
  reading.illegal[kElevation] = errors(TC0, decoder_errors[0]);
  reading.illegal[kPitch] = errors(TC2, decoder_errors[1]);
  reading.illegal[kTravel] = travel_illegal;
  reading.overload_edges = renew_budget();
  return reading;
}

}  // namespace heli::due::encoders

extern "C" void encoder_interrupt() {
  using namespace heli::due;
  using namespace heli::due::encoders;
  // Status before state: an edge between the two calls this again and finds nothing new, the other
  // way round it would be lost.
  static_cast<void>(PIOD->PIO_ISR.read());
  const std::uint32_t now = PIOD->PIO_PDSR.read() & kTravelMask;
  const std::int32_t step = kSteps[travel_state << 2U | now];
  travel_state = now;
  if (step == kIllegal) {
    travel_illegal = travel_illegal + 1U;
  } else {
    travel_count = travel_count + step;
  }
  const std::uint32_t edges = travel_edges + 1U;
  travel_edges = edges;
  if (edges >= kMaxEdges) {
    PIOD->PIO_IDR.write(kTravelMask);
    travel_overloaded = true;
  }
}
