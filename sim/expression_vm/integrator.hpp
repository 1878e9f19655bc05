// Integrates states of an effect along a course that is known beforehand.
#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include "program.hpp"

namespace heli_lab {

// Inputs of `function` are z, time, then what a row of the course holds, then what all rows share.
// What does not depend on z or time is evaluated once a row; the rest step by step.
class Integrator {
 public:
  // `rates` are the values that hold dz/dt, `resets` those that z jumps to at the end of a step.
  Integrator(const Function& function, const std::vector<std::int32_t>& rates,
             const std::vector<std::int32_t>& resets);

  // Integrates by the rule of Runge and Kutta, `substeps` in each row, z being `start` before the
  // first. out is [rows][z], at the end of each row's substep `seen`.
  void run(const std::vector<const double*>& course, const double* t_s, std::size_t rows,
           double step_s, std::size_t substeps, std::size_t seen, const double* start,
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
