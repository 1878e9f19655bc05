// One millisecond of the whole simulation, and its faults; see world.hpp.
#include "world.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <string>
#include <utility>

namespace heli_sim {

namespace {

// Ticks from one look of the operator at the arm to the next.
constexpr std::uint64_t kSupport_ticks = 5;

// How fast a hand turns an axis: a quarter of a turn takes three seconds. It is below the rate
// limits of the flight code.
constexpr double kHand_rad_s = 0.5;
constexpr double kTick_s = 1e-3;

// Throws if a vector has another length than the plant takes.
void require_size(const char* what, std::size_t given, std::size_t wanted) {
  if (given == wanted) return;
  throw std::invalid_argument(std::string(what) + " has " + std::to_string(given) +
                              " numbers; the plant takes " + std::to_string(wanted));
}

}  // namespace

// The mean voltage at a motor for a duty of -1 to 1.
double PowerStage::volts(double duty) const {
  const double size = std::min(std::fabs(duty), 1.0);
  if (size < dead_band) return 0.0;
  const double effective = size > 1.0 - dead_band ? 1.0 : size;
  return std::copysign(effective * supply_V, duty);
}

// Encoders start at the angles of the state.
World::World(std::shared_ptr<SimBoard> board, std::shared_ptr<PlantStep> step,
             std::vector<double> state, std::vector<double> parameters, const PowerStage& power,
             const EncoderConfig& encoders)
    : board_(std::move(board)),
      step_(std::move(step)),
      power_(power),
      encoders_(encoders),
      state_(std::move(state)),
      next_state_(state_.size()),
      parameters_(std::move(parameters)) {
  // NaN: no axis is held by hand.
  hand_rad_.fill(std::numeric_limits<double>::quiet_NaN());
  require_size("the state", state_.size(), step_->state_count());
  require_size("the parameter vector", parameters_.size(), step_->parameter_count());
  std::copy_n(state_.begin(), heli::kAxisCount, angles_rad_.begin());
  encoders_.move(angles_rad_.data());
}

// The rig jumps to another state; encoders follow by counts, as if it had moved there.
void World::set_state(const std::vector<double>& state) {
  require_size("the state", state.size(), state_.size());
  state_ = state;
  std::copy_n(state_.begin(), heli::kAxisCount, angles_rad_.begin());
  encoders_.move(angles_rad_.data());
}

void World::set_parameters(const std::vector<double>& parameters) {
  require_size("the parameter vector", parameters.size(), parameters_.size());
  parameters_ = parameters;
}

std::uint64_t World::advance(std::uint64_t ticks, bool until_output, std::uint64_t least,
                             std::vector<std::uint8_t>& to_host) {
  std::uint64_t passed = 0;
  while (passed < ticks) {
    one_tick(to_host);
    ++passed;
    if (until_output && passed >= least && !to_host.empty()) break;
  }
  return passed;
}

// One millisecond: bytes to the board, its tick, the rig under the new command, the rest of the
// board's millisecond with the edges of that motion, bytes to the host.
void World::one_tick(std::vector<std::uint8_t>& to_host) {
  if (tick_ % kSupport_ticks == 0) support_arm();
  line_.carry_to_board(*board_);
  board_->tick(encoders_.count());
  move_rig();
  if (board_->wants_edges()) {
    const std::vector<Edge>& edges = encoders_.edges();
    board_->rest(edges.data(), edges.size());
  } else {
    board_->rest(nullptr, 0);
  }
  line_.carry_to_host(*board_, to_host);
  ++tick_;
}

// The operator holds the arm, or lets it go; not if somebody else has locked or unlocked axes
// since.
void World::support_arm() {
  if (!support_below_rad_.has_value() || locked_ != supported_) return;
  const bool off = volts_V_[0] == 0.0 && volts_V_[1] == 0.0;
  const bool low = state_[heli::kElevation] <= *support_below_rad_;
  supported_[heli::kElevation] = off && low ? 1.0 : 0.0;
  locked_ = supported_;
}

void World::set_wiring(bool swapped, const std::array<double, 2>& signs) {
  swapped_ = swapped;
  signs_ = signs;
}

// Turns each axis that a hand holds a little towards its target, and stops its rate. Returns which
// axes are locked in this millisecond, by hand or otherwise.
std::array<double, heli::kAxisCount> World::turned_by_hand() {
  std::array<double, heli::kAxisCount> locked = locked_;
  for (std::size_t axis = 0; axis < heli::kAxisCount; ++axis) {
    if (std::isnan(hand_rad_[axis])) continue;
    const double most_rad = kHand_rad_s * kTick_s;
    state_[axis] += std::clamp(hand_rad_[axis] - state_[axis], -most_rad, most_rad);
    state_[heli::kAxisCount + axis] = 0.0;
    locked[axis] = 1.0;
  }
  return locked;
}

// The motors' voltages from the board's output (power stage, cables, supply), then one step of the
// plant and the encoders.
void World::move_rig() {
  const MotorOutput motors = board_->motors();
  const bool drives = motors.enable && supply_on_;
  const std::array<double, 2> output_V{drives ? power_.volts(motors.front_duty) : 0.0,
                                       drives ? power_.volts(motors.back_duty) : 0.0};
  for (std::size_t motor = 0; motor < 2; ++motor) {
    // Adding 0 turns the -0 of a sign into 0.
    volts_V_[motor] = signs_[motor] * output_V[swapped_ ? 1 - motor : motor] + 0.0;
  }
  const std::array<double, heli::kAxisCount> locked = turned_by_hand();
  step_->step(state_.data(), volts_V_.data(), locked.data(), parameters_.data(), next_state_.data(),
              angles_rad_.data());
  state_.swap(next_state_);
  encoders_.move(angles_rad_.data());
}

}  // namespace heli_sim
