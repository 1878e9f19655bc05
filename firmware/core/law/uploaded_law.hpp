// Flight of an uploaded law: its inputs, clock and voltages, and the end of its flight.
#pragma once

#include <cstddef>
#include <cstdint>

#include "board.hpp"
#include "control/bumpless_transfer.hpp"
#include "control/controller.hpp"
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

// Motor voltages of the previous tick, in the telemetry's units.
struct Acted {
  std::int32_t front_raw = 0;
  std::int32_t back_raw = 0;
};

class UploadedLaw {
 public:
  Tape& tape() { return tape_; }

  // Idle loop, as Controller::derive().
  void derive(const params::Params& params, Bank bank);

  // Only the tick calls what follows.
  bool flying() const { return tape_.flying(); }
  // Flies from this tick on; the voltages fade from `acted` to the law's.
  link::Reply engage(const Acted& acted);
  link::Reply set_parameter(const link::LawSetMessage& message);
  // Ends the flight; the board's own law takes over.
  void hand_over(Takeover reason, float value);

  // Runs one tick. False: its flight has ended, and `out` is not filled in.
  bool update(const ControlInput& in, Bank bank, ControlOutput& out);
  // After each update(): the voltages that acted.
  void set_acted(const Acted& acted) { acted_ = acted; }
  std::int32_t setpoint_raw(std::size_t axis) const { return setpoint_raw_[axis]; }
  std::int32_t signal_raw(std::size_t place) const { return signal_raw_[place]; }

  // Brings the arm to rest after its flight; the core stops it when the board's own law does not
  // fly.
  Recovery& recovery() { return recovery_; }
  // Runs one tick of the recovery; true in the first.
  bool recover(ControlInput& in, Bank bank);

  // True from the start of a flight until poll_event() has reported its end and the recovery is
  // over.
  bool busy() const { return busy_; }
  void update_busy() { busy_ = flying() || event_waits_ || recovery_.active(); }
  // True once for each start and end of a flight.
  bool poll_event(link::EventMessage& event);

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
  void read_inputs(const ControlInput& in, const Limits& limits);
  GuardVerdict read_outputs(const Limits& limits);
  void limit(ControlOutput& out, const Limits& limits) const;

  bool busy_ = false;  // the first member, which every tick reads with the fewest instructions
  Tape tape_;
  Guard guard_;
  Recovery recovery_;
  Limits limits_[control::kBanks];

  std::uint32_t phase_ = 0;  // ticks since the call began
  bool called_ = false;      // the law has given an output
  bool fresh_ = false;       // its first output came in this tick
  Acted acted_;
  LawOutput output_;
  LawOutput before_;
  control::BumplessTransfer front_fade_;
  control::BumplessTransfer back_fade_;
  control::RateFilter setpoint_rate_[kAxisCount];
  control::RateFilter setpoint_acceleration_[kAxisCount];
  std::int32_t given_raw_[kAxisCount] = {};
  std::int32_t setpoint_raw_[kAxisCount] = {};
  std::int32_t signal_raw_[link::kLawSignals] = {};
  bool follows_given_[kAxisCount] = {};          // logs the board's setpoint instead of an output
  std::uint32_t given_signal_[kAxisCount] = {};  // that logs the board's; past the last: none
  bool event_waits_ = false;
  link::EventMessage event_;
};

}  // namespace heli::law
