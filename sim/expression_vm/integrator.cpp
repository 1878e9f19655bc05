// Splits a function into values that can be evaluated for all rows beforehand and values that must
// be evaluated in each substep; see integrator.hpp. All values of one substep are in a table: z,
// time, then the others that are used.
#include "integrator.hpp"

#include <algorithm>

namespace heli_lab {
namespace {

// Numbers of the function's inputs.
constexpr std::int32_t kZ = 0;
constexpr std::int32_t kTime = 1;

// Which values depend on z or on time: those must be evaluated step by step.
std::vector<bool> by_z_or_time(const Function& function) {
  std::vector<bool> result(function.values.size(), false);
  for (std::size_t i = 0; i < result.size(); ++i) {
    const Value& value = function.values[i];
    const int count = arguments_of(value.op);
    if (value.op == Op::kInput) {
      result[i] = value.a == kZ || value.a == kTime;
    } else {
      result[i] = (count > 0 && result[static_cast<std::size_t>(value.a)]) ||
                  (count > 1 && result[static_cast<std::size_t>(value.b)]);
    }
  }
  return result;
}

}  // namespace

// Builds both parts. `jumps_`: some reset is not simply its own z.
Integrator::Integrator(const Function& function, const std::vector<std::int32_t>& rates,
                       const std::vector<std::int32_t>& resets)
    : states_(function.widths[kZ]), place_(function.values.size(), -1) {
  const std::vector<bool> sequential = by_z_or_time(function);
  // z and time stand first in the table.
  table_ = states_ + 1;
  for (std::size_t i = 0; i < function.values.size(); ++i) {
    const Value& value = function.values[i];
    if (value.op == Op::kInput && value.a == kZ) {
      place_[i] = value.b;
    } else if (value.op == Op::kInput && value.a == kTime) {
      place_[i] = static_cast<std::int32_t>(states_);
    }
  }
  rates_ = sequence(function, sequential, rates);
  resets_ = sequence(function, sequential, resets);
  for (std::size_t i = 0; i < states_; ++i) {
    jumps_ = jumps_ || resets_.results[i] != static_cast<std::int32_t>(i);
  }
  beforehand_.emplace(function, std::vector<std::vector<std::int32_t>>{known_});
}

// Returns the value's place in the table; at the first call for a value it gets one.
std::int32_t Integrator::place_of(std::int32_t id, const std::vector<bool>& sequential) {
  const auto at = static_cast<std::size_t>(id);
  if (place_[at] < 0) {
    place_[at] = static_cast<std::int32_t>(table_++);
    if (!sequential[at]) {
      known_.push_back(id);
    }
  }
  return place_[at];
}

// The steps that compute the wanted values from z, time and values known beforehand.
Integrator::Stepper Integrator::sequence(const Function& function,
                                         const std::vector<bool>& sequential,
                                         const std::vector<std::int32_t>& wanted) {
  // Backwards: the values that the wanted ones need.
  std::vector<bool> used(function.values.size(), false);
  for (const std::int32_t id : wanted) {
    used[static_cast<std::size_t>(id)] = true;
  }
  for (std::size_t i = used.size(); i-- > 0;) {
    const Value& value = function.values[i];
    const int count = arguments_of(value.op);
    if (!used[i] || !sequential[i]) {
      continue;
    }
    if (count > 0) {
      used[static_cast<std::size_t>(value.a)] = true;
    }
    if (count > 1) {
      used[static_cast<std::size_t>(value.b)] = true;
    }
  }
  // Forwards: a step for each of them that depends on z or time.
  Stepper stepper;
  for (std::size_t i = 0; i < used.size(); ++i) {
    if (!used[i] || !sequential[i] || function.values[i].op == Op::kInput) {
      continue;
    }
    Value value = function.values[i];
    const int count = arguments_of(value.op);
    value.a = place_of(value.a, sequential);
    value.b = count > 1 ? place_of(value.b, sequential) : value.a;
    stepper.steps.push_back(value);
    stepper.places.push_back(place_of(static_cast<std::int32_t>(i), sequential));
  }
  for (const std::int32_t id : wanted) {
    stepper.results.push_back(place_of(id, sequential));
  }
  return stepper;
}

// Runs the steps in the table, and copies the results to `out`.
void Integrator::follow(const Stepper& stepper, double* table, double* out) {
  for (std::size_t i = 0; i < stepper.steps.size(); ++i) {
    const Value& value = stepper.steps[i];
    table[stepper.places[i]] = apply(value.op, table[value.a], table[value.b]);
  }
  for (std::size_t i = 0; i < stepper.results.size(); ++i) {
    out[i] = table[stepper.results[i]];
  }
}

// See integrator.hpp.
void Integrator::run(const std::vector<const double*>& course, const double* t_s, std::size_t rows,
                     double step_s, std::size_t substeps, std::size_t output_substep,
                     const double* start, double* out) const {
  const std::size_t width = known_.size();
  std::vector<double> known(rows * width);
  std::vector<const double*> inputs(course);
  // Values that depend on neither z nor time are evaluated beforehand, for all rows; the inputs z
  // and time may be null there.
  inputs.insert(inputs.begin(), {nullptr, nullptr});
  beforehand_->evaluate(inputs, rows, {known.data()});
  std::vector<double> table(table_);
  std::vector<double> z(start, start + states_);
  std::vector<double> k1(states_);
  std::vector<double> k2(states_);
  std::vector<double> k3(states_);
  std::vector<double> k4(states_);
  const double substep_s = step_s / static_cast<double>(substeps);
  // dz/dt after `time_s` at the rate `slope`, of the equations at the time in the table. At first
  // there is no slope.
  const auto rate_after = [&](double time_s, const std::vector<double>* slope,
                              std::vector<double>& rate) {
    for (std::size_t i = 0; i < states_; ++i) {
      table[i] = z[i] + (slope == nullptr ? 0.0 : time_s * (*slope)[i]);
    }
    follow(rates_, table.data(), rate.data());
  };
  for (std::size_t row = 0; row < rows; ++row) {
    // The values of this row that were evaluated beforehand.
    for (std::size_t k = 0; k < width; ++k) {
      table[static_cast<std::size_t>(place_[static_cast<std::size_t>(known_[k])])] =
          known[row * width + k];
    }
    for (std::size_t sub = 0; sub < substeps; ++sub) {
      // A row's time t_s is the middle of its step.
      const double from_middle = static_cast<double>(sub) - 0.5 * static_cast<double>(substeps);
      const double now_s = t_s[row] + substep_s * from_middle;
      table[states_] = now_s;
      // Runge-Kutta of fourth order; all stages take the substep's first time.
      rate_after(0.0, nullptr, k1);
      rate_after(0.5 * substep_s, &k1, k2);
      rate_after(0.5 * substep_s, &k2, k3);
      rate_after(substep_s, &k3, k4);
      for (std::size_t i = 0; i < states_; ++i) {
        z[i] += substep_s / 6.0 * (k1[i] + 2.0 * k2[i] + 2.0 * k3[i] + k4[i]);
      }
      // Some equations also change z at once, at the end of a substep.
      if (jumps_) {
        std::copy(z.begin(), z.end(), table.begin());
        table[states_] = now_s + substep_s;
        follow(resets_, table.data(), z.data());
      }
      if (sub == output_substep) {
        std::copy(z.begin(), z.end(), out + row * states_);
      }
    }
  }
}

}  // namespace heli_lab
