// Integrates states of an effect along a course that is known beforehand.
#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include "program.hpp"

namespace heli_lab {

// The inputs of `function` are: z, time in s, the columns of the course (one row per sample), and
// values that all rows share. Values that do not depend on z or time are evaluated once per row,
// the others in each substep.
class Integrator {
 public:
  // `rates` are the values that hold dz/dt, `resets` those that z jumps to at the end of a step.
  Integrator(const Function& function, const std::vector<std::int32_t>& rates,
             const std::vector<std::int32_t>& resets);

  // Integrates by the fourth-order Runge-Kutta method with `substeps` per row. `start` is z before
  // the first row. `t_s` is the time in the middle of each row, which lasts `step_s`. Writes z at
  // the end of substep number `output_substep` of each row: out is [rows][z].
  void run(const std::vector<const double*>& course, const double* t_s, std::size_t rows,
           double step_s, std::size_t substeps, std::size_t output_substep, const double* start,
           double* out) const;

 private:
  struct Stepper {
    std::vector<Value> steps;          // operands are places in the table of values
    std::vector<std::int32_t> places;  // where each step's value goes
    std::vector<std::int32_t> results;
  };

  Stepper sequence(const Function& function, const std::vector<bool>& sequential,
                   const std::vector<std::int32_t>& wanted);
  std::int32_t place_of(std::int32_t id, const std::vector<bool>& sequential);
  static void follow(const Stepper& stepper, double* table, double* out);

  std::size_t states_;
  std::vector<std::int32_t> known_;  // values evaluated beforehand, in the order of their places
  std::vector<std::int32_t> place_;  // of each value in the table
  std::size_t table_ = 0;
  Stepper rates_;
  Stepper resets_;
  bool jumps_ = false;
  std::optional<Program> beforehand_;  // once all that it is asked for is known
};

}  // namespace heli_lab
