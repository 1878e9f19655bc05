// Any message of an upload, from any state of the tape, while ticks start and end flights.
#include "law/upload.cpp"

#include "any.hpp"
#include "invariants.hpp"

using heli::law::LawState;
using heli::law::Tape;
using heli::proofs::any;
using heli::proofs::holds;

namespace {

Tape* tape;
std::uint32_t place;  // any word of the tape
std::uint32_t word_in_flight;
std::uint32_t instructions_in_flight;
bool in_tick;

void remember() {
  word_in_flight = tape->image_[place];
  instructions_in_flight = tape->shape_.instructions;
}

bool unchanged() {
  return !tape->flying_.value_ || (tape->image_[place] == word_in_flight &&
                                   tape->shape_.instructions == instructions_in_flight);
}

void prepare_step(Tape& any_tape) {
  tape = &any_tape;
  in_tick = false;
  place = any<std::uint32_t>();
  ASSUME(place < Tape::kWords);
  ASSUME(holds(any_tape));
  remember();
}

}  // namespace

// Contract of the tick: it starts a law only if the tape says `ready`, and may end any flight.
void heli::proofs::interrupt() {
  if (in_tick || !any<bool>()) {
    return;
  }
  in_tick = true;
  CLAIM(unchanged(), "a law that flies is as it was when it took off");
  const bool flew = tape->flying_.value_;
  if (flew || tape->stored_.value_ == LawState::ready) {
    tape->flying_.value_ = any<bool>();
    if (tape->flying_.value_ && !flew) {
      remember();
    }
  }
  in_tick = false;
}

void step_begin() {
  Tape t = any<Tape>();
  prepare_step(t);
  t.begin(any<heli::link::LawBeginMessage>());
  CLAIM(unchanged(), "a law that flies is as it was when it took off");
  CLAIM(holds(t), "the invariant is kept");
}

void step_receive() {
  Tape t = any<Tape>();
  prepare_step(t);
  t.receive(any<heli::link::LawPartMessage>());
  CLAIM(unchanged(), "a law that flies is as it was when it took off");
  CLAIM(holds(t), "the invariant is kept");
}

void step_end() {
  Tape t = any<Tape>();
  prepare_step(t);
  ASSUME(t.stored_.value_ != LawState::receiving);
  t.end();
  CLAIM(unchanged(), "a law that flies is as it was when it took off");
  CLAIM(holds(t), "the invariant is kept");
}
