// Board, line, power stage and rig on one clock of 1 ms.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <optional>
#include <vector>

#include "encoders.hpp"
#include "plant_step.hpp"
#include "serial_line.hpp"
#include "sim_board.hpp"

namespace heli_sim {

struct PowerStage {
  double supply_V;
  // Fraction of the period that the switching delays of the drivers swallow near 0 and near full
  // duty: below it nothing comes out, above 1 minus it the bridge is simply on.
  double dead_band;

  double volts(double duty) const;
};

class World {
 public:
  // `state` begins with elevation, pitch, travel (rad) and their rates (rad/s).
  // Throws std::invalid_argument when the sizes do not fit the step.
  World(std::shared_ptr<SimBoard> board, std::shared_ptr<PlantStep> step, std::vector<double> state,
        std::vector<double> parameters, const PowerStage& power, const EncoderConfig& encoders);

  // Lets up to `ticks` milliseconds pass. With `until_output` it ends early, after the first
  // `least` of them, as soon as bytes reached the host. Returns the milliseconds that passed.
  std::uint64_t advance(std::uint64_t ticks, bool until_output, std::uint64_t least,
                        std::vector<std::uint8_t>& to_host);

  SimBoard& board() { return *board_; }
  SerialLine& line() { return line_; }
  const Encoders& encoders() const { return encoders_; }
  void set_encoder_out(std::size_t axis, bool out) { encoders_.set_out(axis, out); }
  // How the motors' cables are plugged: with `swapped`, the front output drives the back motor; a
  // sign of -1 is a motor whose leads are exchanged.
  void set_wiring(bool swapped, const std::array<double, 2>& signs);
  // A hand on the rig: it turns an axis to its angle (rad) at kHand_rad_s and holds it there. NaN
  // lets go.
  void set_hand(const std::array<double, heli::kAxisCount>& target_rad) { hand_rad_ = target_rad; }
  const std::array<double, heli::kAxisCount>& hand_rad() const { return hand_rad_; }
  // The motors' supply: without it the board drives, and nothing turns.
  void set_supply_on(bool on) { supply_on_ = on; }
  bool supply_on() const { return supply_on_; }
  std::uint64_t tick() const { return tick_; }
  const std::vector<double>& state() const { return state_; }
  void set_state(const std::vector<double>& state);
  const std::vector<double>& parameters() const { return parameters_; }
  void set_parameters(const std::vector<double>& parameters);
  const std::array<double, 2>& volts_V() const { return volts_V_; }
  void set_locked(const std::array<double, heli::kAxisCount>& locked) { locked_ = locked; }
  const std::array<double, heli::kAxisCount>& locked() const { return locked_; }
  // Until take-off an operator supports the arm on its table: while the motors are off the
  // elevation is locked below `elevation_rad`. Axes that somebody else has locked stay as they are.
  void support_below(double elevation_rad) { support_below_rad_ = elevation_rad; }

 private:
  void one_tick(std::vector<std::uint8_t>& to_host);
  void support_arm();
  void move_rig();
  std::array<double, heli::kAxisCount> turned_by_hand();

  std::shared_ptr<SimBoard> board_;
  std::shared_ptr<PlantStep> step_;
  SerialLine line_;
  PowerStage power_;
  Encoders encoders_;
  std::vector<double> state_;
  std::vector<double> next_state_;
  std::vector<double> parameters_;
  std::array<double, heli::kAxisCount> angles_rad_{};
  std::array<double, heli::kAxisCount> locked_{};
  std::array<double, heli::kAxisCount> supported_{};  // as the operator last locked them
  std::optional<double> support_below_rad_;
  std::array<double, heli::kAxisCount> hand_rad_;
  bool swapped_ = false;
  std::array<double, 2> signs_{1.0, 1.0};
  std::array<double, 2> volts_V_{};
  std::uint64_t tick_ = 0;
  bool supply_on_ = true;
};

}  // namespace heli_sim
