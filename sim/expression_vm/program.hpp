// Straight-line programs: functions without loops or branches, evaluated in every row of a table.
#pragma once

#include <cstddef>
#include <cstdint>
#include <string_view>
#include <vector>

namespace heli_lab {

// NAME, arguments, value with x and y. The names are CasADi's.
#define HELI_OPERATIONS(_)                         \
  _(ASSIGN, 1, x)                                  \
  _(ADD, 2, x + y)                                 \
  _(SUB, 2, x - y)                                 \
  _(MUL, 2, x* y)                                  \
  _(DIV, 2, x / y)                                 \
  _(NEG, 1, -x)                                    \
  _(EXP, 1, std::exp(x))                           \
  _(LOG, 1, std::log(x))                           \
  _(POW, 2, std::pow(x, y))                        \
  _(CONSTPOW, 2, std::pow(x, y))                   \
  _(SQRT, 1, std::sqrt(x))                         \
  _(SQ, 1, x* x)                                   \
  _(TWICE, 1, x + x)                               \
  _(SIN, 1, std::sin(x))                           \
  _(COS, 1, std::cos(x))                           \
  _(TAN, 1, std::tan(x))                           \
  _(ASIN, 1, std::asin(x))                         \
  _(ACOS, 1, std::acos(x))                         \
  _(ATAN, 1, std::atan(x))                         \
  _(LT, 2, x < y ? 1.0 : 0.0)                      \
  _(LE, 2, x <= y ? 1.0 : 0.0)                     \
  _(EQ, 2, x == y ? 1.0 : 0.0)                     \
  _(NE, 2, x != y ? 1.0 : 0.0)                     \
  _(NOT, 1, x == 0.0 ? 1.0 : 0.0)                  \
  _(AND, 2, x != 0.0 && y != 0.0 ? 1.0 : 0.0)      \
  _(OR, 2, x != 0.0 || y != 0.0 ? 1.0 : 0.0)       \
  _(FLOOR, 1, std::floor(x))                       \
  _(CEIL, 1, std::ceil(x))                         \
  _(FMOD, 2, std::fmod(x, y))                      \
  _(FABS, 1, std::fabs(x))                         \
  _(SIGN, 1, x < 0.0 ? -1.0 : (x > 0.0 ? 1.0 : x)) \
  _(COPYSIGN, 2, std::copysign(x, y))              \
  _(IF_ELSE_ZERO, 2, x != 0.0 ? y : 0.0)           \
  _(ERF, 1, std::erf(x))                           \
  _(FMIN, 2, std::isnan(x) ? y : (y < x ? y : x))  \
  _(FMAX, 2, std::isnan(x) ? y : (y > x ? y : x))  \
  _(INV, 1, 1.0 / x)                               \
  _(SINH, 1, std::sinh(x))                         \
  _(COSH, 1, std::cosh(x))                         \
  _(TANH, 1, std::tanh(x))                         \
  _(ASINH, 1, std::asinh(x))                       \
  _(ACOSH, 1, std::acosh(x))                       \
  _(ATANH, 1, std::atanh(x))                       \
  _(ATAN2, 2, std::atan2(x, y))                    \
  _(LOG1P, 1, std::log1p(x))                       \
  _(EXPM1, 1, std::expm1(x))                       \
  _(HYPOT, 2, std::hypot(x, y))                    \
  _(REMAINDER, 2, std::remainder(x, y))

enum class Op : std::uint8_t {
#define HELI_NAME(name, arguments, value) k##name,
  HELI_OPERATIONS(HELI_NAME)
#undef HELI_NAME
      kConstant,
  kInput,
};

constexpr std::string_view kOperationNames[] = {
#define HELI_NAME(name, arguments, value) #name,
    HELI_OPERATIONS(HELI_NAME)
#undef HELI_NAME
        "CONST",
    "INPUT"};

// Number of operands of an operation.
constexpr int arguments_of(Op op) {
  constexpr int kArguments[] = {
#define HELI_NAME(name, arguments, value) arguments,
      HELI_OPERATIONS(HELI_NAME)
#undef HELI_NAME
          0,
      0};
  return kArguments[static_cast<int>(op)];
}

// One value of a program. `a` and `b` are earlier values; of kInput the input and the element in
// it.
struct Value {
  Op op = Op::kConstant;
  std::int32_t a = 0;
  std::int32_t b = 0;
  double constant = 0.0;
};

// The last input is the same in all rows, the others have a row each.
struct Function {
  std::vector<Value> values;
  std::vector<std::size_t> widths;  // of the inputs
};

double apply(Op op, double x, double y);

// The wanted values of a function in each row of a table.
class Program {
 public:
  Program(const Function& function, const std::vector<std::vector<std::int32_t>>& wanted);

  // inputs[i] is [rows][widths[i]], the last one [widths.back()]; outputs[i] is [rows][wanted[i]].
  void evaluate(const std::vector<const double*>& inputs, std::size_t rows,
                const std::vector<double*>& outputs) const;

 private:
  // Places of operands: uniform values lie in a table of scalars, others in one of vectors.
  struct Operand {
    std::int32_t place = 0;
    bool uniform = false;
  };
  struct Step {
    Op op = Op::kConstant;
    std::int32_t to = 0;
    Operand a;
    Operand b;
  };
  // An element of an input that goes into a register.
  struct Loaded {
    std::int32_t to = 0;
    std::int32_t input = 0;
    std::int32_t element = 0;
  };

  void run(const std::vector<const double*>& inputs, std::size_t rows, const double* scalars,
           const std::vector<double*>& outputs) const;

  std::vector<std::size_t> widths_;
  std::vector<Value> scalars_;  // uniform values; operands are places in this list
  std::vector<Loaded> loads_;
  std::vector<Step> steps_;
  std::vector<std::vector<Operand>> wanted_;
  std::size_t registers_ = 0;
};

// Which values differ from row to row: those that depend on another input than the last.
std::vector<bool> varying(const Function& function);

}  // namespace heli_lab
