// The parameter table in memory: every value finite, in range and fit for its kind, at all times.
#pragma once

#include <cstddef>
#include <cstdint>

#include "link/declaration.hpp"

namespace heli::params {

// The tick changes values, while commands are executed; tick and idle loop read them.
class Params {
 public:
  Params() { defaults(); }

  float get(link::Param which) const { return values_[static_cast<std::size_t>(which)]; }

  // ok, no_such_parameter, out_of_range (also not finite, zero or not whole where the declaration
  // forbids it) or unsafe_now (declared idle-only, and `idle` is false). Only ok changes anything.
  link::Result set(link::Param which, float value, bool idle);

  // Whether set() would take the value while idle.
  static link::Result check(link::Param which, float value);

  void defaults();

  // kParamCount values in the order of the declaration.
  const float* data() const { return values_; }

  // False when values that are each in range contradict each other; arming needs true.
  bool consistent() const;

  // Changes whenever a value may have changed; owners of derived constants compare it.
  std::uint32_t revision() const { return revision_; }

 private:
  float values_[link::kParamCount] = {};
  std::uint32_t revision_ = 0;
};

}  // namespace heli::params
