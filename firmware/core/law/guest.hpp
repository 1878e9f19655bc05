// The law that came over the link, in flight: its inputs, its clock, its voltages, and its end.
#pragma once

#include <cstddef>
#include <cstdint>

#include "board.hpp"
#include "control/controller.hpp"
#include "control/fade.hpp"
#include "control/rate_filter.hpp"
#include "law/guard.hpp"
#include "law/recovery.hpp"
#include "law/tape.hpp"
#include "link/mailbox.hpp"
#include "params/params.hpp"

namespace heli::law {

using control::Bank;
using control::ControlInput;
using control::ControlOutput;

// What acted in the tick before, as it was logged.
struct Acted {
  std::int32_t front_raw = 0;
  std::int32_t back_raw = 0;
};

class Guest {
 public:
  Tape& tape() { return tape_; }

  // Idle loop, like a Controller's.
  void derive(const params::Params& params, Bank bank);

  // Tick: what follows.
  bool flying() const { return tape_.flying(); }
  // Flies from this tick on; `acted` is what the voltages fade from.
  link::Reply engage(const Acted& acted);
  link::Reply set_parameter(const link::LawSetMessage& message);
  // Hands over to the board's own law.
  void leave(Takeover reason, float value);

  // One tick of it. False: it has left, and `out` is not filled in.
  bool update(const ControlInput& in, Bank bank, ControlOutput& out);
  // What acted then; behind each update().
  void note(const Acted& acted) { acted_ = acted; }
  std::int32_t setpoint_raw(std::size_t axis) const { return setpoint_raw_[axis]; }
  std::int32_t signal_raw(std::size_t place) const { return signal_raw_[place]; }

  // What follows its flight; the core ends it where the board's own law does not fly the arm.
  Recovery& recovery() { return recovery_; }
  // One tick of it; true in the first.
  bool recover(ControlInput& in, Bank bank);

  // From the beginning of a flight until the news of its end was taken, and the arm is in hand.
  bool busy() const { return busy_; }
  void settle() { busy_ = flying() || news_waits_ || recovery_.active(); }
  // True once for each beginning and end of a flight.
  bool take_news(link::EventMessage& news);

 private:
  struct Limits {
    GuardLimits guard;
    RecoveryLimits recovery;
    control::Share smoothing[kAxisCount];
    control::Share bumpless_keep;
    Quantity motor_min_V;
    Quantity motor_max_V;
    Quantity differential_max_V;
  };

  void choose_signals();
  void see(const ControlInput& in, const Limits& limits);
  Judgement take_outputs(const Limits& limits);
  void limit(ControlOutput& out, const Limits& limits) const;

  bool busy_ = false;  // first, where every tick reaches it at once
  Tape tape_;
  Guard guard_;
  Recovery recovery_;
  Limits limits_[control::kBanks];

  std::uint32_t phase_ = 0;  // ticks since the call began
  bool called_ = false;      // an output has come
  bool fresh_ = false;       // the first one has, in this tick
  Acted acted_;
  Wish wish_;
  Wish before_;
  control::Fade front_fade_;
  control::Fade back_fade_;
  control::RateFilter setpoint_rate_[kAxisCount];
  control::RateFilter setpoint_acceleration_[kAxisCount];
  std::int32_t given_raw_[kAxisCount] = {};
  std::int32_t setpoint_raw_[kAxisCount] = {};
  std::int32_t signal_raw_[link::kLawSignals] = {};
  bool follows_given_[kAxisCount] = {};          // logs the board's setpoint, not one of its own
  std::uint32_t given_signal_[kAxisCount] = {};  // that tells the board's; beyond the last: none
  bool news_waits_ = false;
  link::EventMessage news_;
};

}  // namespace heli::law
