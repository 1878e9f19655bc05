// Any message of an upload, from any state of the tape, while ticks start and end flights.
#include "any.hpp"
#include "law/upload.cpp"
#include "upload/invariant.hpp"

using heli::law::LawState;
using heli::law::Tape;
using heli::proofs::any;
using heli::proofs::holds;

namespace {

Tape* tape;
std::uint32_t place;  // any word of the tape
std::uint32_t word_in_flight;
std::uint32_t instructions_in_flight;

// Notes the tape at take-off, at one place that may be any.
void remember() {
  word_in_flight = tape->image_[place];
  instructions_in_flight = tape->shape_.instructions;
}

// A law that flies has the tape that was noted.
bool unchanged() {
  return !tape->flying_.value_ || (tape->image_[place] == word_in_flight &&
                                   tape->shape_.instructions == instructions_in_flight);
}

// Any tape that satisfies the invariant.
void prepare_step(Tape& any_tape) {
  CONSTANT(Tape::kWords);
  tape = &any_tape;
  place = any<std::uint32_t>();
  ASSUME(place < Tape::kWords);
  any_tape.stored_.show();
  any_tape.flying_.show();
  ASSUME(holds(any_tape));
  remember();
}

// After the call, and after one more interrupt.
void check_step() {
  heli::proofs::show_stores();
  heli::proofs::interrupt();
  CLAIM(unchanged(), "a law that flies is as it was when it took off");
  CLAIM(holds(*tape), "the invariant is kept");
}

}  // namespace

// Contract of the tick: it starts a law only if the tape says `ready`, and may end any flight.
void heli::proofs::interrupt() {
  if (!any<bool>()) {
    return;
  }
  CLAIM(unchanged(), "a law that flies is as it was when it took off");
  const bool flew = tape->flying_.value_;
  if (flew || tape->stored_.shown_ == LawState::ready) {
    tape->flying_.value_ = any<bool>();
    if (tape->flying_.value_ && !flew) {
      remember();
    }
  }
}

void heli::proofs::show_stores() { tape->stored_.show(); }

namespace heli::link {

// Contract: reads the bytes that it is given, and returns any number.
std::uint32_t crc32(const std::uint8_t*, std::size_t, std::uint32_t) {
  return any<std::uint32_t>();
}

}  // namespace heli::link

// The message that begins an upload.
void step_begin() {
  Tape t = any<Tape>();
  prepare_step(t);
  t.begin(any<heli::link::LawBeginMessage>());
  check_step();
}

// A message with words of the upload.
void step_receive() {
  Tape t = any<Tape>();
  prepare_step(t);
  t.receive(any<heli::link::LawPartMessage>());
  check_step();
}
