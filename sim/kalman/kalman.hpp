// Kalman filter and fixed-interval smoother of a linear time-varying system that random
// disturbances drive.
#pragma once

#include <cstddef>
#include <vector>

#include "../wide.hpp"

namespace heli_lab {

// Adds a weighted sum of table rows: to[c] += sum over j of weights[j] table[j][c]. The table has
// `count` rows of `columns` numbers. Begins at column c and takes `kTogether` columns at a time,
// whose sums stay in registers. Returns the first column that did not fit.
template <std::size_t kTogether>
HELI_INLINE std::size_t add_columns(const double* weights, std::size_t count, const double* table,
                                    std::size_t columns, std::size_t c, double* to) {
  for (; c + kTogether <= columns; c += kTogether) {
    double sum[kTogether];
    for (std::size_t k = 0; k < kTogether; ++k) {
      sum[k] = to[c + k];
    }
    for (std::size_t j = 0; j < count; ++j) {
      const double weight = weights[j];
      const double* line = table + j * columns + c;
      for (std::size_t k = 0; k < kTogether; ++k) {
        sum[k] += weight * line[k];
      }
    }
    for (std::size_t k = 0; k < kTogether; ++k) {
      to[c + k] = sum[k];
    }
  }
  return c;
}

// The same for all columns.
HELI_INLINE void add_rows(const double* weights, std::size_t count, const double* table,
                          std::size_t columns, double* to) {
  std::size_t c = add_columns<16>(weights, count, table, columns, 0, to);
  c = add_columns<4>(weights, count, table, columns, c, to);
  add_columns<1>(weights, count, table, columns, c, to);
}

// Sum of products of two rows of `count` numbers, of which the second has a `stride`.
HELI_INLINE double dot(const double* a, const double* b, std::size_t count,
                       std::size_t stride = 1) {
  double sum = 0.0;
  for (std::size_t j = 0; j < count; ++j) {
    sum += a[j] * b[j * stride];
  }
  return sum;
}

// Subtracts or adds a multiple of a row: to[c] += weight row[c].
HELI_INLINE void add_multiple(double weight, const double* row, std::size_t count, double* to) {
  for (std::size_t c = 0; c < count; ++c) {
    to[c] += weight * row[c];
  }
}

// e' = transition e + input w + drive, w' = memory^parts w + noise, y = measurement e + error; a
// prime is the next step. Matrices are row-major, one per step. `columns` signals are filtered with
// the same gains, because filtering is linear. A step has one or more equal parts. The disturbances
// w are groups of `kind` each; groups differ by their memory only. A disturbance decays by its
// memory in each part, so its effect in a step is the sum over the parts of memory^part times
// part_input.
struct LinearSystem {
  std::size_t steps = 0;
  std::size_t parts = 0;
  std::size_t states = 0;
  std::size_t outputs = 0;
  std::size_t disturbances = 0;
  std::size_t kind = 0;
  std::size_t columns = 0;
  const double* transition = nullptr;            // [steps][states][states]
  const double* part_input = nullptr;            // [parts][steps][states][kind]
  const double* measurement = nullptr;           // [steps][outputs][states]
  const double* measurement_variance = nullptr;  // [steps][outputs]; 0 where nothing was measured
  const double* memory = nullptr;                // [disturbances], of a part
  const double* disturbance_variance = nullptr;  // [disturbances], stationary
  const double* initial_variance = nullptr;      // [states]
  const double* drive = nullptr;                 // [steps][states][columns]
  const double* measured = nullptr;              // [steps][outputs][columns]
};

// Writes the innovations divided by their standard deviations, [steps][outputs][columns], and for
// each output the sum of the logarithms of their variances, [outputs].
void filter(const LinearSystem& system, double* innovations, double* log_variances);

// The log-likelihood of the first column under several models of the disturbances, without its
// constant: for each output minus half the sum of squares and of logarithms of variances,
// [models][outputs]. Each model has a memory and a variance of its disturbances,
// [models][disturbances], and scales the measurement's variances, [models][outputs]; those of the
// system are not used. Four models cost little more than one.
void log_likelihoods(const LinearSystem& system, std::size_t models, const double* memory,
                     const double* disturbance_variance, const double* scale, double* values);

// Mean of state and disturbances at each step by the first column, before and after the step's
// measurement, [steps][states + disturbances] each.
void track(const LinearSystem& system, double* predicted, double* filtered);

// Smooths the first column: mean and variance of state and disturbances at each step,
// [steps][states + disturbances].
void smooth(const LinearSystem& system, double* mean, double* variance);

// Score and Fisher information of an addition to each state and disturbance just before the
// measurement of each step, [steps][states + disturbances]: the auxiliary residuals of de Jong and
// Penzer, J. Am. Stat. Assoc. 93 (1998) 796. A disturbance with memory 1 and variance 0 is a level
// that begins there, one with memory 0 and variance 0 an impulse.
void shock_scores(const LinearSystem& system, double* score, double* information);

// Rates that drive deviations: e' = transition e + input rates. Row-major, one matrix per step.
struct Signals {
  std::size_t steps = 0;
  std::size_t states = 0;
  std::size_t columns = 0;
  const double* transition = nullptr;  // [steps][states][states]
  const double* input = nullptr;       // [steps][states][states]
  const double* rates = nullptr;       // [steps][states][columns]
};

// Deviation at the end of each block of steps, from zero at its beginning: [steps / block][states]
// [columns].
void over_blocks(const Signals& signals, std::size_t block, double* out);

// Transition over each block of steps, [steps / block][states][states], and the deviation at its
// end that the rates of each of its steps cause alone, [block][steps / block][states][columns].
void block_response(const Signals& signals, std::size_t block, double* transition, double* parts);

// Implicit midpoint rule over steps of `step_s`, for de/dt = jacobian e + rates: writes the
// transition and the input matrix of the rates. All matrices are [steps][states][states].
void midpoint(const double* jacobian, std::size_t steps, std::size_t states, double step_s,
              double* transition, double* input);

}  // namespace heli_lab
