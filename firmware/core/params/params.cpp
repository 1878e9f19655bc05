// Checks of single parameters and of their combination; the ranges are link.toml's. See params.hpp.
#include "params/params.hpp"

#include <cmath>
#include <initializer_list>

namespace heli::params {

using link::Param;
using link::Result;

Result Params::check(Param which, float value) {
  const auto index = static_cast<std::size_t>(which);
  if (index >= link::kParamCount) return Result::no_such_parameter;
  const link::ParamInfo& info = link::kParams[index];
  // Written so that NaN fails: every comparison with it is false.
  if (!(value >= info.min && value <= info.max)) return Result::out_of_range;
  if (info.nonzero && value == 0.0F) return Result::out_of_range;
  if (info.integer && std::trunc(value) != value) return Result::out_of_range;
  return Result::ok;
}

Result Params::set(Param which, float value, bool idle) {
  const Result result = check(which, value);
  if (result != Result::ok) return result;
  const auto index = static_cast<std::size_t>(which);
  if (link::kParams[index].idle_only && !idle) return Result::unsafe_now;
  values_[index] = value;
  ++revision_;
  return Result::ok;
}

void Params::defaults() {
  for (std::size_t i = 0; i < link::kParamCount; ++i) values_[i] = link::kParams[i].initial;
  ++revision_;
}

bool Params::consistent() const {
  // With less than one count per revolution, the angle of a count could overflow.
  for (const Param counts : {Param::elevation_counts_per_rev, Param::pitch_counts_per_rev,
                             Param::travel_counts_per_rev}) {
    if (std::fabs(get(counts)) < 1.0F) return false;
  }
  return get(Param::motor_min_V) < get(Param::motor_max_V) &&
         get(Param::motor_max_V) <= get(Param::supply_V) &&
         get(Param::setpoint_hold_s) < get(Param::setpoint_land_s) &&
         get(Param::elevation_rest_deg) < get(Param::elevation_max_deg) &&
         get(Param::pitch_setpoint_max_deg) < get(Param::pitch_max_deg);
}

}  // namespace heli::params
