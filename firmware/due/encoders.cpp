// Two encoders in the decoders of TC0 and TC2, the third by pin interrupts with a limited rate; see
// encoders.hpp. encoder_interrupt() is the interrupt; read() runs in the tick, which it may
// interrupt.
#include <cstdint>
#include <wiring.hpp>

#include "cortex_m3.hpp"
#include "drivers.hpp"
#include "pins.hpp"
#include "registers.hpp"

namespace heli::due::encoders {
namespace {

// Pulses shorter than 64 periods of the master clock (0.76 us) are noise: even at 200,000 edges per
// second, edges are 5 us apart.
constexpr std::uint32_t kFilter = TC_BMR_FILTER | TC_BMR_MAXFILT(63);

// Both edges of both lines: four counts per pulse.
constexpr std::uint32_t kDecoder = TC_BMR_QDEN | TC_BMR_POSEN | TC_BMR_EDGPHA | kFilter;

// The datasheet demands the external trigger on TIOA, which the decoder replaces by its index
// input. D10 and A6 are those inputs. They must stay unconnected: an edge there would clear the
// count.
constexpr std::uint32_t kPosition = TC_CMR_TCCLKS_XC0 | TC_CMR_ETRGEDG_RISING | TC_CMR_ABETRG;

constexpr std::uint32_t kEdgeMask = pins::kInterruptA.mask() | pins::kInterruptB.mask();
static_assert(pins::kInterruptA.number == 0 && pins::kInterruptB.number == 1 && kEdgeMask == 3U,
              "the masked port is the index of the transition table");

// Edges that are served per tick: twice the number at 200,000 edges per second. Serving them takes
// less than a third of the tick, so that noise on the lines starves neither the tick nor the idle
// loop.
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
volatile std::int32_t edge_count;
volatile std::uint32_t illegal_edges;
volatile std::uint32_t edges_in_tick;  // since the tick looked
volatile bool overloaded;
std::uint32_t line_state;  // of the third encoder, B then A; the interrupt's own

std::uint32_t decoder_errors[2];  // illegal transitions since power-up; the tick's own

// A trigger clears the counter at the next edge of its clock, which is not counted (datasheet,
// 36.6.2): an edge of the master clock takes it here, or a step of the decoder would be lost. Where
// the count then begins does not matter: the core sets its zero at its first tick.
void start_decoder(At<Tc> tc) {
  tc->TC_BMR.write(kDecoder);
  tc->TC_CHANNEL[0].TC_CMR.write(0);
  tc->TC_CHANNEL[0].TC_CCR.write(TC_CCR_CLKEN | TC_CCR_SWTRG);
  static_cast<void>(tc->TC_CHANNEL[0].TC_CV.read());
  tc->TC_CHANNEL[0].TC_CMR.write(kPosition);
}

// Adds the error that the decoder has reported since the last reading, at most one.
std::uint32_t count_errors(At<Tc> tc, std::uint32_t& count) {
  if ((tc->TC_QISR.read() & TC_QISR_QERR) != 0U) ++count;
  return count;
}

// How many edges used up the budget, 0 if it was enough; the next tick has a new one.
std::uint32_t renew_budget() {
  edges_in_tick = 0;
  if (!overloaded) return 0;
  overloaded = false;
  PIOD->PIO_IER.write(kEdgeMask);
  return kMaxEdges;
}

}  // namespace

void start() {
  // Clocks, pins and decoders of elevation and pitch (by the default wiring).
  PMC->PMC_PCER0.write(bit(ID_TC0));
  PMC->PMC_PCER1.write(bit(ID_TC6 - 32));
  pins::to_peripheral_b(PIOB, pins::kTc0A.mask() | pins::kTc0B.mask());
  pins::to_peripheral_b(PIOC, pins::kTc2A.mask() | pins::kTc2B.mask());
  start_decoder(TC0);
  start_decoder(TC2);

  // The third encoder's lines are inputs that interrupt at each edge.
  PIOD->PIO_ODR.write(kEdgeMask);
  PIOD->PIO_PER.write(kEdgeMask);
  line_state = PIOD->PIO_PDSR.read() & kEdgeMask;
  // After reset a pin's interrupt comes at both edges.
  PIOD->PIO_IER.write(kEdgeMask);
  enable_interrupt(ID_PIOD, kEncoderPriority);
}

EncoderReading read() {
  EncoderReading reading{};
  reading.count[wiring::kTc0Axis] = static_cast<std::int32_t>(TC0->TC_CHANNEL[0].TC_CV.read());
  reading.count[wiring::kTc2Axis] = static_cast<std::int32_t>(TC2->TC_CHANNEL[0].TC_CV.read());
  reading.count[wiring::kInterruptAxis] = edge_count;
  reading.illegal[wiring::kTc0Axis] = count_errors(TC0, decoder_errors[0]);
  reading.illegal[wiring::kTc2Axis] = count_errors(TC2, decoder_errors[1]);
  reading.illegal[wiring::kInterruptAxis] = illegal_edges;
  reading.overload_edges = renew_budget();
  return reading;
}

}  // namespace heli::due::encoders

extern "C" void encoder_interrupt() {
  using namespace heli::due;
  using namespace heli::due::encoders;
  // Status before state: an edge between the two reads causes another interrupt, which finds
  // nothing new. In the other order that edge would be lost.
  static_cast<void>(PIOD->PIO_ISR.read());
  const std::uint32_t now = PIOD->PIO_PDSR.read() & kEdgeMask;
  const std::int32_t step = kSteps[line_state << 2U | now];
  line_state = now;
  if (step == kIllegal) {
    illegal_edges = illegal_edges + 1U;
  } else {
    edge_count = edge_count + step;
  }
  // Too many edges: no more interrupts until the next tick.
  const std::uint32_t edges = edges_in_tick + 1U;
  edges_in_tick = edges;
  if (edges >= kMaxEdges) {
    PIOD->PIO_IDR.write(kEdgeMask);
    overloaded = true;
  }
}
