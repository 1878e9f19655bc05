// Compiles a function to steps on registers, and runs it in blocks of rows; see program.hpp.
#include "program.hpp"

#include <algorithm>
#include <cmath>

#include "../wide.hpp"

namespace heli_lab {
namespace {

// Rows that an operation takes at once: long enough that choosing the operation costs little, short
// enough that the values in use stay in the first two caches.
constexpr std::size_t kLanes = 32;

// to[i] = f(a[i], b[i]) for kLanes rows; a uniform operand has one value for all rows. At most one
// of the two is uniform.
template <typename F>
void each(F f, double* to, const double* a, bool a_uniform, const double* b, bool b_uniform) {
  if (a_uniform) {
    const double x = *a;
    for (std::size_t i = 0; i < kLanes; ++i) {
      to[i] = f(x, b[i]);
    }
  } else if (b_uniform) {
    const double y = *b;
    for (std::size_t i = 0; i < kLanes; ++i) {
      to[i] = f(a[i], y);
    }
  } else {
    for (std::size_t i = 0; i < kLanes; ++i) {
      to[i] = f(a[i], b[i]);
    }
  }
}

}  // namespace

// One operation on numbers.
double apply(Op op, double x, double y) {
  switch (op) {
#define HELI_CASE(name, arguments, value) \
  case Op::k##name:                       \
    static_cast<void>(y);                 \
    return value;
    HELI_OPERATIONS(HELI_CASE)
#undef HELI_CASE
    default:
      return 0.0;
  }
}

// See program.hpp. The last input is the one that all rows share.
std::vector<bool> varying(const Function& function) {
  std::vector<bool> result(function.values.size(), false);
  for (std::size_t i = 0; i < result.size(); ++i) {
    const Value& value = function.values[i];
    const int count = arguments_of(value.op);
    if (value.op == Op::kInput) {
      result[i] = static_cast<std::size_t>(value.a) + 1 < function.widths.size();
    } else {
      result[i] = (count > 0 && result[static_cast<std::size_t>(value.a)]) ||
                  (count > 1 && result[static_cast<std::size_t>(value.b)]);
    }
  }
  return result;
}

// The last value that reads each value: -1 if none does, the number of values for an output.
std::vector<std::int64_t> last_readers(const std::vector<Value>& values,
                                       const std::vector<std::vector<std::int32_t>>& wanted) {
  const auto output_reader = static_cast<std::int64_t>(values.size());
  std::vector<std::int64_t> last(values.size(), -1);
  for (const std::vector<std::int32_t>& output : wanted) {
    for (const std::int32_t id : output) {
      last[static_cast<std::size_t>(id)] = output_reader;
    }
  }
  for (std::size_t i = values.size(); i-- > 0;) {
    if (last[i] < 0) {
      continue;
    }
    const int operands = arguments_of(values[i].op);
    for (int k = 0; k < operands; ++k) {
      std::int64_t& reader = last[static_cast<std::size_t>(k == 0 ? values[i].a : values[i].b)];
      reader = std::max(reader, static_cast<std::int64_t>(i));
    }
  }
  return last;
}

// Uniform values become scalars. The others become steps, whose values are in registers: a register
// is free again after the last step that reads its value.
Program::Program(const Function& function, const std::vector<std::vector<std::int32_t>>& wanted)
    : widths_(function.widths) {
  const std::vector<Value>& values = function.values;
  const std::size_t count = values.size();
  const std::vector<bool> vary = varying(function);
  std::vector<std::int64_t> last_reader = last_readers(values, wanted);
  // Place of each value among the scalars or the registers, and the registers that are free.
  std::vector<std::int32_t> place(count, -1);
  std::vector<std::int32_t> free_registers;
  const auto operand = [&](std::int32_t id) {
    const auto at = static_cast<std::size_t>(id);
    return Operand{place[at], !vary[at]};
  };
  for (std::size_t i = 0; i < count; ++i) {
    if (last_reader[i] < 0) {
      continue;
    }
    const Value& value = values[i];
    const int operands = arguments_of(value.op);
    // A uniform value: its operands are scalars too.
    if (!vary[i]) {
      Value scalar = value;
      if (operands > 0) {
        scalar.a = place[static_cast<std::size_t>(value.a)];
      }
      if (operands > 1) {
        scalar.b = place[static_cast<std::size_t>(value.b)];
      }
      place[i] = static_cast<std::int32_t>(scalars_.size());
      scalars_.push_back(scalar);
      continue;
    }
    Step step;
    step.op = value.op;
    if (operands > 0) {
      step.a = operand(value.a);
      // An operation with one argument gets it twice.
      step.b = operands > 1 ? operand(value.b) : step.a;
    }
    // Operands that are read for the last time give their registers back.
    for (int k = 0; k < operands; ++k) {
      const auto read = static_cast<std::size_t>(k == 0 ? value.a : value.b);
      if (vary[read] && last_reader[read] == static_cast<std::int64_t>(i)) {
        free_registers.push_back(place[read]);
        last_reader[read] = -1;
      }
    }
    if (free_registers.empty() || value.op == Op::kInput) {
      place[i] = static_cast<std::int32_t>(registers_++);
    } else {
      place[i] = free_registers.back();
      free_registers.pop_back();
    }
    if (value.op == Op::kInput) {
      loads_.push_back({place[i], value.a, value.b});
    } else {
      step.to = place[i];
      steps_.push_back(step);
    }
  }
  for (const std::vector<std::int32_t>& output : wanted) {
    wanted_.emplace_back();
    for (const std::int32_t id : output) {
      wanted_.back().push_back(operand(id));
    }
  }
}

// Evaluates the scalars once, then all rows.
void Program::evaluate(const std::vector<const double*>& inputs, std::size_t rows,
                       const std::vector<double*>& outputs) const {
  std::vector<double> scalars(scalars_.size());
  for (std::size_t i = 0; i < scalars.size(); ++i) {
    const Value& value = scalars_[i];
    if (value.op == Op::kConstant) {
      scalars[i] = value.constant;
    } else if (value.op == Op::kInput) {
      scalars[i] = inputs.back()[value.b];
    } else {
      const double x = scalars[static_cast<std::size_t>(value.a)];
      const double y = arguments_of(value.op) > 1 ? scalars[static_cast<std::size_t>(value.b)] : x;
      scalars[i] = apply(value.op, x, y);
    }
  }
  run(inputs, rows, scalars.data(), outputs);
}

// Evaluates the steps for kLanes rows at a time: loads the inputs into registers, runs the steps,
// stores the outputs.
HELI_WIDE
void Program::run(const std::vector<const double*>& inputs, std::size_t rows, const double* scalars,
                  const std::vector<double*>& outputs) const {
  std::vector<double> vectors(registers_ * kLanes);
  for (std::size_t start = 0; start < rows; start += kLanes) {
    // The last block may be short: its last row fills the remaining lanes.
    const std::size_t here = std::min(kLanes, rows - start);
    for (const Loaded& load : loads_) {
      const std::size_t stride = widths_[static_cast<std::size_t>(load.input)];
      const double* from =
          inputs[static_cast<std::size_t>(load.input)] + start * stride + load.element;
      double* to = vectors.data() + static_cast<std::size_t>(load.to) * kLanes;
      for (std::size_t i = 0; i < kLanes; ++i) {
        to[i] = from[std::min(i, here - 1) * stride];
      }
    }
    for (const Step& step : steps_) {
      double* to = vectors.data() + static_cast<std::size_t>(step.to) * kLanes;
      const auto at = [&](const Operand& operand) {
        const auto place = static_cast<std::size_t>(operand.place);
        return operand.uniform ? scalars + place : vectors.data() + place * kLanes;
      };
      const double* a = at(step.a);
      const double* b = at(step.b);
      switch (step.op) {
#define HELI_CASE(name, arguments, value)                                                     \
  case Op::k##name:                                                                           \
    each([](double x, [[maybe_unused]] double y) { return value; }, to, a, step.a.uniform, b, \
         step.b.uniform);                                                                     \
    break;
        HELI_OPERATIONS(HELI_CASE)
#undef HELI_CASE
        default:
          break;
      }
    }
    for (std::size_t output = 0; output < wanted_.size(); ++output) {
      const std::vector<Operand>& wanted = wanted_[output];
      const std::size_t width = wanted.size();
      for (std::size_t k = 0; k < width; ++k) {
        const auto place = static_cast<std::size_t>(wanted[k].place);
        double* to = outputs[output] + start * width + k;
        if (wanted[k].uniform) {
          for (std::size_t i = 0; i < here; ++i) {
            to[i * width] = scalars[place];
          }
        } else {
          const double* from = vectors.data() + place * kLanes;
          for (std::size_t i = 0; i < here; ++i) {
            to[i * width] = from[i];
          }
        }
      }
    }
  }
}

}  // namespace heli_lab
