// Incremental encoders: angles to counts, and to the edges inside a millisecond.
#pragma once

#include <cstdint>
#include <vector>

#include "sim_board.hpp"

namespace heli_sim {

struct EncoderConfig {
  double counts_per_rad[heli::kAxisCount];
  // Where the disc stands relative to the angle, in counts; its fraction is the phase of the first
  // edge. A free-running counter starts anywhere.
  double offset_count[heli::kAxisCount];
};

class Encoders {
 public:
  explicit Encoders(const EncoderConfig& config) : config_(config) {}

  // The plug of an axis is out, or in: while it is out nothing counts, and what moved meanwhile is
  // lost.
  void set_out(std::size_t axis, bool out) { out_[axis] = out; }
  bool out(std::size_t axis) const { return out_[axis]; }

  // Reads the angles; those of the last call stay as the start of the millisecond for edges().
  void move(const double* angle_rad);

  const std::int32_t* count() const { return count_; }

  // Edges between the last two calls of move(), in order of time. The angle is taken as linear in
  // time within the millisecond; a turn-back inside it has no edges of its own.
  const std::vector<Edge>& edges();

 private:
  EncoderConfig config_;
  double before_[heli::kAxisCount] = {};  // position in counts
  double now_[heli::kAxisCount] = {};
  double lost_[heli::kAxisCount] = {};
  bool out_[heli::kAxisCount] = {};
  std::int32_t count_[heli::kAxisCount] = {};
  std::vector<Edge> edges_;
  bool moved_ = false;
};

}  // namespace heli_sim
