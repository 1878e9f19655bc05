#include "encoders.hpp"

#include <algorithm>
#include <cmath>

namespace heli_sim {

namespace {

std::int64_t floor_count(double position) {
  return static_cast<std::int64_t>(std::floor(position));
}

}  // namespace

void Encoders::move(const double* angle_rad) {
  for (std::size_t axis = 0; axis < heli::kAxisCount; ++axis) {
    double position =
        angle_rad[axis] * config_.counts_per_rad[axis] + config_.offset_count[axis] - lost_[axis];
    if (out_[axis] && moved_) {
      lost_[axis] += position - now_[axis];
      position = now_[axis];
    }
    before_[axis] = moved_ ? now_[axis] : position;
    now_[axis] = position;
    count_[axis] = static_cast<std::int32_t>(floor_count(position));
  }
  moved_ = true;
}

const std::vector<Edge>& Encoders::edges() {
  edges_.clear();
  for (std::size_t axis = 0; axis < heli::kAxisCount; ++axis) {
    const std::int64_t from = floor_count(before_[axis]);
    const std::int64_t to = floor_count(now_[axis]);
    if (from == to) continue;
    const bool up = to > from;
    const double us_per_count =
        static_cast<double>(heli::link::kTick_us) / (now_[axis] - before_[axis]);
    const auto axis_index = static_cast<std::uint8_t>(axis);
    // Upwards the count changes when the position reaches a whole number, downwards when it falls
    // below one.
    const std::int64_t first = up ? from + 1 : to + 1;
    const std::int64_t last = up ? to : from;
    for (std::int64_t line = first; line <= last; ++line) {
      const double time_us = (static_cast<double>(line) - before_[axis]) * us_per_count;
      edges_.push_back(
          {std::clamp(time_us, 0.0, 999.999), axis_index, static_cast<std::int8_t>(up ? 1 : -1)});
    }
  }
  std::stable_sort(edges_.begin(), edges_.end(),
                   [](const Edge& a, const Edge& b) { return a.time_us < b.time_us; });
  return edges_;
}

}  // namespace heli_sim
