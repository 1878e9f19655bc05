// The encoders between the plant's angles and the board.
#include <nanobind/nanobind.h>
#include <nanobind/stl/array.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include <algorithm>
#include <array>
#include <tuple>
#include <vector>

#include "encoders.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace {

using heli_sim::Edge;
using heli_sim::Encoders;

using Axes = std::array<double, heli::kAxisCount>;

Encoders encoders_of(const Axes& counts_per_rad, const Axes& offset_count) {
  heli_sim::EncoderConfig config{};
  std::copy(counts_per_rad.begin(), counts_per_rad.end(), config.counts_per_rad);
  std::copy(offset_count.begin(), offset_count.end(), config.offset_count);
  return Encoders(config);
}

std::vector<std::tuple<double, int, int>> encoder_edges(const Axes& from_rad, const Axes& to_rad,
                                                        const Axes& counts_per_rad,
                                                        const Axes& offset_count) {
  Encoders encoders = encoders_of(counts_per_rad, offset_count);
  encoders.move(from_rad.data());
  encoders.move(to_rad.data());
  std::vector<std::tuple<double, int, int>> edges;
  for (const Edge& edge : encoders.edges()) {
    edges.emplace_back(edge.time_us, edge.axis, edge.direction);
  }
  return edges;
}

std::array<std::int32_t, heli::kAxisCount> encoder_counts(const Axes& angle_rad,
                                                          const Axes& counts_per_rad,
                                                          const Axes& offset_count) {
  Encoders encoders = encoders_of(counts_per_rad, offset_count);
  encoders.move(angle_rad.data());
  std::array<std::int32_t, heli::kAxisCount> count{};
  std::copy_n(encoders.count(), heli::kAxisCount, count.begin());
  return count;
}

}  // namespace

void bind_plant(nb::module_& module) {
  nb::module_ m = module.def_submodule("plant", "The simulated encoders.");
  m.def("encoder_edges", &encoder_edges, "from_rad"_a, "to_rad"_a, "counts_per_rad"_a,
        "offset_count"_a,
        "Edges (time_us, axis, direction) of a millisecond in which the angles move linearly.");
  m.def("encoder_counts", &encoder_counts, "angle_rad"_a, "counts_per_rad"_a, "offset_count"_a,
        "Counts of three encoders at these angles.");
}
