// Python's values as the flight code's and back.
#pragma once

#include <nanobind/nanobind.h>

#include <array>
#include <cstdint>
#include <stdexcept>
#include <tuple>
#include <vector>

#include "control/fixed.hpp"
#include "link/declaration.hpp"
#include "params/params.hpp"

namespace heli_test {

using Bytes = std::vector<std::uint8_t>;
using Triple = std::array<float, heli::link::kAxisCount>;  // in the order of the axes
// Index and value of each parameter that is not to have its default.
using ParamValues = std::vector<std::tuple<int, float>>;

inline const std::uint8_t* data_of(const nanobind::bytes& from) {
  return reinterpret_cast<const std::uint8_t*>(from.c_str());
}

inline nanobind::bytes to_python(const std::uint8_t* from, std::size_t count) {
  return nanobind::bytes(reinterpret_cast<const char*>(from), count);
}

inline nanobind::bytes to_python(const Bytes& from) { return to_python(from.data(), from.size()); }

inline heli::params::Params params_from(const ParamValues& values) {
  heli::params::Params params;
  for (const auto& [index, value] : values) {
    if (params.set(static_cast<heli::link::Param>(index), value, true) != heli::link::Result::ok) {
      throw std::invalid_argument("parameter refused");
    }
  }
  return params;
}

}  // namespace heli_test
