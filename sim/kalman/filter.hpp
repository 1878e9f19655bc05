// The Kalman filter step by step, for filter(), track(), and the forward pass of the smoother; see
// kalman.hpp. "Order" is the number of states and disturbances together; all matrices are
// row-major.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <vector>

#include "kalman.hpp"

namespace heli_lab {
// Unnamed, because only kalman.cpp includes this: the compiler may inline as within one file.
namespace {

// Innovations below this count as 0. The effect of a window's beginning decays so far that its
// squares would be denormal numbers, with which the processor is a hundred times slower.
constexpr double kNegligible = 1e-60;

// The results of one step that the backward pass of the smoother needs.
struct StepRecord {
  std::vector<double> mean;        // predicted, [order]
  std::vector<double> covariance;  // predicted, [order][order]
  std::vector<double> gain;        // [outputs][order]
  std::vector<double> innovation;  // [outputs], not normalised
  std::vector<double> variance;    // [outputs]; 0 where nothing was measured
};

// Mean and covariance of [states, disturbances], from the initial ones on: update(0), predict(0),
// update(1) and so on.
class Filter {
 public:
  // Begins before the first measurement: means of 0, and the initial variances without covariances.
  explicit Filter(const LinearSystem& system)
      : system_(system),
        order_(system.states + system.disturbances),
        mean_(order_ * system.columns, 0.0),
        next_(system.states * system.columns),
        covariance_(order_ * order_, 0.0),
        product_(system.states * order_),
        gain_(order_),
        input_(system.states * system.disturbances),
        step_memory_(system.disturbances) {
    for (std::size_t i = 0; i < system.disturbances; ++i) {
      step_memory_[i] = std::pow(system.memory[i], static_cast<double>(system.parts));
    }
    for (std::size_t i = 0; i < system.states; ++i) {
      covariance_[i * order_ + i] = system.initial_variance[i];
    }
    for (std::size_t i = 0; i < system.disturbances; ++i) {
      const std::size_t place = system.states + i;
      covariance_[place * order_ + place] = system.disturbance_variance[i];
    }
  }

  // Measurement update of one step. Uses the measurements one output after the other, because
  // their errors are independent. Writes the innovations divided by their standard deviation,
  // [outputs][columns], and adds the logarithms of their variances. `record` may be null.
  HELI_INLINE void update(std::size_t step, double* innovations, double* log_variances,
                          StepRecord* record) {
    const std::size_t states = system_.states;
    const std::size_t columns = system_.columns;
    for (std::size_t output = 0; output < system_.outputs; ++output) {
      double* out = innovations + output * columns;
      const double error = system_.measurement_variance[step * system_.outputs + output];
      if (record != nullptr) {
        record->variance[output] = 0.0;
      }
      if (!(error > 0.0)) {
        std::fill(out, out + columns, 0.0);
        continue;  // nothing was measured
      }
      // Covariance of the output with each state: P h', and its variance h P h' + r.
      const double* row = system_.measurement + (step * system_.outputs + output) * states;
      for (std::size_t i = 0; i < order_; ++i) {
        gain_[i] = dot(row, covariance_.data() + i, states, order_);
      }
      double variance = error;
      for (std::size_t j = 0; j < states; ++j) {
        variance += row[j] * gain_[j];
      }
      // Innovation of each column: measured - h mean.
      const double* measured = system_.measured + (step * system_.outputs + output) * columns;
      std::copy(measured, measured + columns, out);
      for (std::size_t j = 0; j < states; ++j) {
        if (row[j] != 0.0) {
          add_multiple(-row[j], mean_.data() + j * columns, columns, out);
        }
      }
      if (record != nullptr) {
        record->innovation[output] = out[0];
        record->variance[output] = variance;
        for (std::size_t i = 0; i < order_; ++i) {
          record->gain[output * order_ + i] = gain_[i] / variance;
        }
      }
      // Normalised innovation; then mean += K innovation and P -= K h P.
      const double scale = 1.0 / std::sqrt(variance);
      for (std::size_t c = 0; c < columns; ++c) {
        out[c] = std::fabs(out[c]) < kNegligible ? 0.0 : out[c] * scale;
      }
      for (std::size_t i = 0; i < order_; ++i) {
        const double weight = gain_[i] * scale;
        add_multiple(weight, out, columns, mean_.data() + i * columns);
        add_multiple(-(weight * scale), gain_.data(), order_, covariance_.data() + i * order_);
      }
      log_variances[output] += std::log(variance);
    }
  }

  // Time update, from after the measurement of `step` to before the next one: mean and covariance
  // through F = [transition disturbance_input; 0 memory], plus the disturbances' new noise.
  HELI_INLINE void predict(std::size_t step) {
    const std::size_t states = system_.states;
    const std::size_t disturbances = system_.disturbances;
    const double* phi = system_.transition + step * states * states;
    const double* input = disturbance_input(step);
    multiply_states_rows(step, phi, input);
    propagate_mean();
    propagate_covariance(phi, input);
    // Noise that keeps the stationary variance.
    for (std::size_t i = 0; i < disturbances; ++i) {
      const double lost = 1.0 - step_memory_[i] * step_memory_[i];
      covariance_[(states + i) * order_ + states + i] += lost * system_.disturbance_variance[i];
    }
  }

  // Effect on the states, at the end of the step, of a unit of each disturbance at its beginning:
  // [states][disturbances]. A disturbance decays from part to part.
  HELI_INLINE const double* disturbance_input(std::size_t step) {
    const std::size_t kind = system_.kind;
    const std::size_t size = system_.states * kind;
    std::fill(input_.begin(), input_.end(), 0.0);
    for (std::size_t first = 0; first < system_.disturbances; first += kind) {
      for (std::size_t k = 0; k < kind; ++k) {
        double remaining = 1.0;  // of the disturbance, at the part's beginning
        for (std::size_t part = 0; part < system_.parts; ++part) {
          const double* from = system_.part_input + (part * system_.steps + step) * size + k;
          for (std::size_t i = 0; i < system_.states; ++i) {
            input_[i * system_.disturbances + first + k] += remaining * from[i * kind];
          }
          remaining *= system_.memory[first + k];
        }
      }
    }
    return input_.data();
  }

  // The factor by which each disturbance decays in a whole step.
  const std::vector<double>& step_memory() const { return step_memory_; }

  // Mean of the first column, and covariance, as they are now: before the step's measurement.
  void record_prediction(StepRecord& record) const {
    first_column(record.mean.data());
    record.covariance = covariance_;
  }

  // Writes the mean of the first column, [order].
  void first_column(double* out) const {
    for (std::size_t i = 0; i < order_; ++i) {
      out[i] = mean_[i * system_.columns];
    }
  }

 private:
  // The states' rows of F times the mean, plus the drive, in `next_`; and times the covariance, in
  // `product_`.
  HELI_INLINE void multiply_states_rows(std::size_t step, const double* phi, const double* input) {
    const std::size_t states = system_.states;
    const std::size_t disturbances = system_.disturbances;
    const std::size_t columns = system_.columns;
    const double* drive = system_.drive + step * states * columns;
    std::copy(drive, drive + states * columns, next_.begin());
    std::fill(product_.begin(), product_.end(), 0.0);
    double* row = gain_.data();
    for (std::size_t i = 0; i < states; ++i) {
      std::copy(phi + i * states, phi + (i + 1) * states, row);
      std::copy(input + i * disturbances, input + (i + 1) * disturbances, row + states);
      add_rows(row, order_, mean_.data(), columns, next_.data() + i * columns);
      add_rows(row, order_, covariance_.data(), order_, product_.data() + i * order_);
    }
  }

  // The mean becomes F mean + drive; each disturbance decays by its memory.
  HELI_INLINE void propagate_mean() {
    std::copy(next_.begin(), next_.end(), mean_.begin());
    for (std::size_t i = 0; i < system_.disturbances; ++i) {
      double* to = mean_.data() + (system_.states + i) * system_.columns;
      for (std::size_t c = 0; c < system_.columns; ++c) {
        to[c] *= step_memory_[i];
      }
    }
  }

  // The covariance becomes F covariance F': first states with states, then states with
  // disturbances, then disturbances.
  HELI_INLINE void propagate_covariance(const double* phi, const double* input) {
    const std::size_t states = system_.states;
    const std::size_t disturbances = system_.disturbances;
    for (std::size_t i = 0; i < states; ++i) {
      const double* line = product_.data() + i * order_;
      for (std::size_t k = 0; k <= i; ++k) {
        double sum = dot(line, phi + k * states, states);
        for (std::size_t j = 0; j < disturbances; ++j) {
          sum += line[states + j] * input[k * disturbances + j];
        }
        covariance_[i * order_ + k] = sum;
        covariance_[k * order_ + i] = sum;
      }
      for (std::size_t j = 0; j < disturbances; ++j) {
        const double element = line[states + j] * step_memory_[j];
        covariance_[i * order_ + states + j] = element;
        covariance_[(states + j) * order_ + i] = element;
      }
    }
    for (std::size_t i = 0; i < disturbances; ++i) {
      for (std::size_t j = 0; j < disturbances; ++j) {
        covariance_[(states + i) * order_ + states + j] *= step_memory_[i] * step_memory_[j];
      }
    }
  }

  const LinearSystem& system_;
  std::size_t order_;
  std::vector<double> mean_;        // [order][columns]
  std::vector<double> next_;        // the states' next mean, [states][columns]
  std::vector<double> covariance_;  // [order][order]
  std::vector<double> product_;     // F times covariance, [states][order]
  std::vector<double> gain_;        // scratch, [order]
  std::vector<double> input_;       // disturbance_input(), [states][disturbances]
  std::vector<double> step_memory_;
};

}  // namespace
}  // namespace heli_lab
