// Counts from angles, and the edges between two angles; see encoders.hpp.
#include "encoders.hpp"

#include <algorithm>
#include <cmath>

namespace heli_sim {

namespace {

// The count at a position in counts.
std::int64_t floor_count(double position) {
  return static_cast<std::int64_t>(std::floor(position));
}

}  // namespace

// See encoders.hpp. While an encoder is unplugged its position stays, and the motion is added to
// what is lost.
void Encoders::move(const double* angle_rad) {
  for (std::size_t axis = 0; axis < heli::kAxisCount; ++axis) {
    double position = angle_rad[axis] * config_.counts_per_rad[axis] + config_.offset_count[axis] -
                      lost_count_[axis];
    if (unplugged_[axis] && has_position_) {
      lost_count_[axis] += position - position_count_[axis];
      position = position_count_[axis];
    }
    previous_count_[axis] = has_position_ ? position_count_[axis] : position;
    position_count_[axis] = position;
    count_[axis] = static_cast<std::int32_t>(floor_count(position));
  }
  has_position_ = true;
}

// See encoders.hpp. An edge is at the time at which the position passes a whole number.
const std::vector<Edge>& Encoders::edges() {
  edges_.clear();
  for (std::size_t axis = 0; axis < heli::kAxisCount; ++axis) {
    const std::int64_t from = floor_count(previous_count_[axis]);
    const std::int64_t to = floor_count(position_count_[axis]);
    if (from == to) continue;
    const bool upwards = to > from;
    // Negative when the position falls, as the differences of counts below are.
    const double moved_count = position_count_[axis] - previous_count_[axis];
    const auto axis_index = static_cast<std::uint8_t>(axis);
    // Upwards the count changes when the position reaches a whole number, downwards when it falls
    // below one.
    const std::int64_t first = upwards ? from + 1 : to + 1;
    const std::int64_t last = upwards ? to : from;
    for (std::int64_t edge_count = first; edge_count <= last; ++edge_count) {
      const double passed_count = static_cast<double>(edge_count) - previous_count_[axis];
      // Divided first: the inverse of the smallest movement is infinite.
      const double time_us = passed_count / moved_count * heli::link::kTick_us;
      // Within the millisecond of 1000 us, also after rounding.
      edges_.push_back({std::clamp(time_us, 0.0, 999.999), axis_index,
                        static_cast<std::int8_t>(upwards ? 1 : -1)});
    }
  }
  std::stable_sort(edges_.begin(), edges_.end(),
                   [](const Edge& a, const Edge& b) { return a.time_us < b.time_us; });
  return edges_;
}

}  // namespace heli_sim
