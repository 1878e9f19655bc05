// Incremental encoders: angles to counts, and to the edges inside a millisecond.
#pragma once

#include <cstdint>
#include <vector>

#include "sim_board.hpp"

namespace heli_sim {

struct EncoderConfig {
  double counts_per_rad[heli::kAxisCount];
  // Count at angle 0. Its fraction is the phase of the first edge. Any value is possible, because a
  // free-running counter starts anywhere.
  double offset_count[heli::kAxisCount];
};

class Encoders {
 public:
  explicit Encoders(const EncoderConfig& config) : config_(config) {}

  // Unplugs or plugs in the encoder of an axis. While it is unplugged nothing counts; the motion in
  // that time is lost.
  void set_out(std::size_t axis, bool out) { unplugged_[axis] = out; }
  bool out(std::size_t axis) const { return unplugged_[axis]; }

  // Reads the angles at the end of a millisecond; those of the previous call are its start.
  void move(const double* angle_rad);

  const std::int32_t* count() const { return count_; }

  // Edges between the last two calls of move(), in order of time. The angle is taken as linear in
  // time within the millisecond; a turn-back inside it has no edges of its own.
  const std::vector<Edge>& edges();

 private:
  EncoderConfig config_;
  double previous_count_[heli::kAxisCount] = {};  // position in counts
  double position_count_[heli::kAxisCount] = {};
  double lost_count_[heli::kAxisCount] = {};  // motion while unplugged
  bool unplugged_[heli::kAxisCount] = {};
  std::int32_t count_[heli::kAxisCount] = {};
  std::vector<Edge> edges_;
  bool has_position_ = false;
};

}  // namespace heli_sim
