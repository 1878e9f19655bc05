// Straight-line programs for Python. A program comes as parallel lists with one entry per value:
// its operation, its operands `a` and `b`, and its constant; see program.hpp.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include <cstdint>
#include <stdexcept>
#include <string>
#include <vector>

#include "integrator.hpp"
#include "program.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace {

using heli_lab::Function;
using heli_lab::Integrator;
using heli_lab::Op;
using heli_lab::Program;
using heli_lab::Value;

using In = nb::ndarray<const double, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
using Line = nb::ndarray<const double, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using Out = nb::ndarray<nb::numpy, double, nb::ndim<2>>;

// Throws ValueError in Python if an argument is wrong.
void require(bool holds, const char* what) {
  if (!holds) {
    throw std::invalid_argument(what);
  }
}

// Checks such lists and makes a function of them. `widths` are the lengths of the inputs' rows.
// Operands `a` and `b` of an operation are the numbers of earlier values; those of an input are the
// number of the input and of its element.
Function function_of(const std::vector<int>& operations, const std::vector<std::int32_t>& a,
                     const std::vector<std::int32_t>& b, const std::vector<double>& constants,
                     const std::vector<std::size_t>& widths) {
  require(a.size() == operations.size() && b.size() == operations.size() &&
              constants.size() == operations.size(),
          "a, b and constants must have one entry an operation");
  require(!widths.empty(), "a function has inputs");
  Function function;
  function.widths = widths;
  for (std::size_t i = 0; i < operations.size(); ++i) {
    require(operations[i] >= 0 && operations[i] <= static_cast<int>(Op::kInput),
            "unknown operation");
    const auto op = static_cast<Op>(operations[i]);
    const int count = heli_lab::arguments_of(op);
    const auto number = static_cast<std::int32_t>(i);
    if (op == Op::kInput) {
      require(a[i] >= 0 && static_cast<std::size_t>(a[i]) < widths.size() && b[i] >= 0 &&
                  static_cast<std::size_t>(b[i]) < widths[static_cast<std::size_t>(a[i])],
              "no such input");
    }
    require(count < 1 || (a[i] >= 0 && a[i] < number), "a value is read before it is there");
    require(count < 2 || (b[i] >= 0 && b[i] < number), "a value is read before it is there");
    function.values.push_back({op, a[i], b[i], constants[i]});
  }
  return function;
}

// Checks that the outputs are values of the function.
void check_wanted(const Function& function, const std::vector<std::int32_t>& wanted) {
  for (const std::int32_t id : wanted) {
    require(id >= 0 && static_cast<std::size_t>(id) < function.values.size(), "no such value");
  }
}

// A new numpy array; numpy frees it.
Out table(std::size_t rows, std::size_t columns) {
  auto* data = new double[rows * columns];
  const nb::capsule owner(data, [](void* p) noexcept { delete[] static_cast<double*>(p); });
  return Out(data, {rows, columns}, owner);
}

// The data of the inputs with rows, then of the input that all rows share. Checks their shapes
// against `widths`, of which the first `first` are not given here.
std::vector<const double*> pointers(const std::vector<In>& rows, const Line& shared,
                                    const std::vector<std::size_t>& widths, std::size_t first) {
  require(rows.size() + 1 + first == widths.size(), "another number of inputs");
  std::vector<const double*> result;
  for (std::size_t i = 0; i < rows.size(); ++i) {
    require(rows[i].shape(0) == rows[0].shape(0), "inputs differ in their rows");
    require(rows[i].shape(1) == widths[first + i], "an input has another width");
    result.push_back(rows[i].data());
  }
  require(shared.shape(0) == widths.back(), "the last input has another width");
  result.push_back(shared.data());
  return result;
}

// A function that Python evaluates for all rows of a table at once: program.hpp.
class TableProgram {
 public:
  TableProgram(const std::vector<int>& operations, const std::vector<std::int32_t>& a,
               const std::vector<std::int32_t>& b, const std::vector<double>& constants,
               const std::vector<std::size_t>& widths,
               const std::vector<std::vector<std::int32_t>>& wanted)
      : widths_(widths), program_(made(operations, a, b, constants, widths, wanted)) {
    for (const std::vector<std::int32_t>& output : wanted) {
      sizes_.push_back(output.size());
    }
  }

  // One array per output, with a row for each row of the inputs.
  std::vector<Out> evaluate(const std::vector<In>& rows, const Line& shared) const {
    require(!rows.empty(), "no input has rows");
    const std::vector<const double*> inputs = pointers(rows, shared, widths_, 0);
    std::vector<Out> results;
    std::vector<double*> outputs;
    for (const std::size_t size : sizes_) {
      results.push_back(table(rows[0].shape(0), size));
      outputs.push_back(results.back().data());
    }
    {
      const nb::gil_scoped_release release;
      program_.evaluate(inputs, rows[0].shape(0), outputs);
    }
    return results;
  }

 private:
  // The compiled program, after all checks.
  static Program made(const std::vector<int>& operations, const std::vector<std::int32_t>& a,
                      const std::vector<std::int32_t>& b, const std::vector<double>& constants,
                      const std::vector<std::size_t>& widths,
                      const std::vector<std::vector<std::int32_t>>& wanted) {
    const Function function = function_of(operations, a, b, constants, widths);
    for (const std::vector<std::int32_t>& output : wanted) {
      check_wanted(function, output);
    }
    return Program(function, wanted);
  }

  std::vector<std::size_t> widths_;
  std::vector<std::size_t> sizes_;
  Program program_;
};

// An integrator of differential equations along known inputs: integrator.hpp.
class CourseIntegrator {
 public:
  CourseIntegrator(const std::vector<int>& operations, const std::vector<std::int32_t>& a,
                   const std::vector<std::int32_t>& b, const std::vector<double>& constants,
                   const std::vector<std::size_t>& widths, const std::vector<std::int32_t>& rates,
                   const std::vector<std::int32_t>& resets)
      : widths_(widths), integrator_(made(operations, a, b, constants, widths, rates, resets)) {}

  // z at the end of one substep of each row; the arguments are those of Integrator::run().
  Out run(const std::vector<In>& course, const Line& t_s, const Line& shared, double step_s,
          std::size_t substeps, std::size_t output_substep, const Line& start) const {
    require(!course.empty(), "no input has rows");
    const std::vector<const double*> inputs = pointers(course, shared, widths_, 2);
    const std::size_t rows = t_s.shape(0);
    require(course[0].shape(0) == rows, "t_s has another length than the course");
    require(start.shape(0) == widths_[0], "start has another length than z");
    require(output_substep < substeps, "there is no such substep");
    Out out = table(rows, widths_[0]);
    {
      const nb::gil_scoped_release release;
      integrator_.run(inputs, t_s.data(), rows, step_s, substeps, output_substep, start.data(),
                      out.data());
    }
    return out;
  }

 private:
  // The integrator, after all checks.
  static Integrator made(const std::vector<int>& operations, const std::vector<std::int32_t>& a,
                         const std::vector<std::int32_t>& b, const std::vector<double>& constants,
                         const std::vector<std::size_t>& widths,
                         const std::vector<std::int32_t>& rates,
                         const std::vector<std::int32_t>& resets) {
    require(widths.size() > 3 && widths[1] == 1, "inputs are z, time, a row, what rows share");
    const Function function = function_of(operations, a, b, constants, widths);
    check_wanted(function, rates);
    check_wanted(function, resets);
    require(rates.size() == widths[0] && resets.size() == widths[0],
            "rates and resets must have one value a state");
    return Integrator(function, rates, resets);
  }

  std::vector<std::size_t> widths_;
  Integrator integrator_;
};

}  // namespace

NB_MODULE(_expression_vm, module) {
  std::vector<std::string> names;
  for (const auto name : heli_lab::kOperationNames) {
    names.emplace_back(name);
  }
  module.attr("OPERATIONS") = nb::cast(names);
  nb::class_<TableProgram>(module, "TableProgram")
      .def(nb::init<const std::vector<int>&, const std::vector<std::int32_t>&,
                    const std::vector<std::int32_t>&, const std::vector<double>&,
                    const std::vector<std::size_t>&,
                    const std::vector<std::vector<std::int32_t>>&>(),
           "operations"_a, "a"_a, "b"_a, "constants"_a, "widths"_a, "wanted"_a)
      .def("evaluate", &TableProgram::evaluate, "rows"_a, "shared"_a);
  nb::class_<CourseIntegrator>(module, "CourseIntegrator")
      .def(nb::init<const std::vector<int>&, const std::vector<std::int32_t>&,
                    const std::vector<std::int32_t>&, const std::vector<double>&,
                    const std::vector<std::size_t>&, const std::vector<std::int32_t>&,
                    const std::vector<std::int32_t>&>(),
           "operations"_a, "a"_a, "b"_a, "constants"_a, "widths"_a, "rates"_a, "resets"_a)
      .def("run", &CourseIntegrator::run, "course"_a, "t_s"_a, "shared"_a, "step_s"_a, "substeps"_a,
           "seen"_a, "start"_a);
}
