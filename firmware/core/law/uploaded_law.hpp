// Flight of an uploaded law: its inputs, clock and voltages, and the end of its flight.
#pragma once

#include <cstddef>
#include <cstdint>

#include "board.hpp"
#include "control/controller.hpp"
#include "control/loop.hpp"
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
struct AppliedVoltages {
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
  // Flies from this tick on; the voltages fade from `applied` to the law's.
  link::Reply engage(const AppliedVoltages& applied);
  link::Reply set_parameter(const link::LawSetMessage& message);
  // Ends the flight; the board's own law takes over.
  void hand_over(Takeover reason, float value);

  // Runs one tick. False: its flight has ended, and `out` is not filled in.
  bool update(const ControlInput& in, Bank bank, ControlOutput& out);
  // After each update(): the voltages that acted.
  void set_applied(const AppliedVoltages& applied) { applied_ = applied; }
  std::int32_t setpoint_raw(std::size_t axis) const { return setpoint_raw_[axis]; }
  std::int32_t signal_raw(std::size_t index) const { return signal_raw_[index]; }

  // Brings the arm to rest after its flight; the core stops it when the board's own law does not
  // fly.
  Recovery& recovery() { return recovery_; }
  // Runs one tick of the recovery; true in the first.
  bool recover(ControlInput& in, Bank bank);

  // True from the start of a flight until poll_event() has reported its end and the recovery is
  // over.
  bool busy() const { return busy_; }
  void update_busy() { busy_ = flying() || event_pending_ || recovery_.active(); }
  // True once for each start and end of a flight.
  bool poll_event(link::EventMessage& event);

 private:
  // Derived from the parameters in the idle loop.
  struct Limits {
    GuardLimits guard;
    RecoveryLimits recovery;
    control::Share smoothing[kAxisCount];  // of the setpoints' rates, per tick
    control::Share bumpless_keep;          // of a voltage jump, that remains after one tick
    Quantity motor_min_V;
    Quantity motor_max_V;
    Quantity differential_max_V;
  };

  void assign_setpoint_signals();
  void read_inputs(const ControlInput& in, const Limits& limits);
  GuardVerdict read_outputs(const Limits& limits);
  void limit_voltages(ControlOutput& out, const Limits& limits) const;

  bool busy_ = false;  // the first member, which every tick reads with the fewest instructions
  Tape tape_;
  Guard guard_;
  Recovery recovery_;
  Limits limits_[control::kBanks];

  std::uint32_t phase_ = 0;    // ticks since the call began
  bool has_output_ = false;    // the law has given an output
  bool first_output_ = false;  // its first output came in this tick
  AppliedVoltages applied_;
  LawOutput output_;
  LawOutput previous_output_;
  control::BumplessTransfer front_fade_;
  control::BumplessTransfer back_fade_;
  control::RateFilter setpoint_rate_[kAxisCount];
  control::RateFilter setpoint_acceleration_[kAxisCount];
  std::int32_t board_setpoint_raw_[kAxisCount] = {};  // given to the law
  std::int32_t setpoint_raw_[kAxisCount] = {};        // logged
  std::int32_t signal_raw_[link::kLawSignals] = {};
  bool passes_board_setpoint_[kAxisCount] = {};  // logs the board's setpoint instead of an output
  // Signal that logs the board's setpoint; link::kLawSignals: none.
  std::uint32_t board_setpoint_signal_[kAxisCount] = {};
  bool event_pending_ = false;
  link::EventMessage event_;
};

}  // namespace heli::law
