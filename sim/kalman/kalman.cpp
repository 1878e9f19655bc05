// Kalman filter, tracking and the backward pass of smoother and shock scores; see kalman.hpp.
// "Order" is the number of states and disturbances together; all matrices are row-major.
#include "kalman.hpp"

#include <algorithm>
#include <cmath>

namespace heli_lab {
namespace {

constexpr double kNegligible = 1e-60;  // innovations below count as 0

// What the backward pass of the smoother needs of a step.
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

  // Uses the measurements of a step, one output after the other, because their errors are
  // independent. Writes the innovations divided by their standard deviation, [outputs][columns],
  // and adds the logarithms of their variances. `record` may be null.
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
        continue;
      }
      const double* row = system_.measurement + (step * system_.outputs + output) * states;
      for (std::size_t i = 0; i < order_; ++i) {
        double sum = 0.0;
        for (std::size_t j = 0; j < states; ++j) {
          sum += row[j] * covariance_[j * order_ + i];
        }
        gain_[i] = sum;
      }
      double variance = error;
      for (std::size_t j = 0; j < states; ++j) {
        variance += row[j] * gain_[j];
      }
      const double scale = 1.0 / std::sqrt(variance);
      const double* measured = system_.measured + (step * system_.outputs + output) * columns;
      std::copy(measured, measured + columns, out);
      for (std::size_t j = 0; j < states; ++j) {
        const double weight = row[j];
        if (weight == 0.0) {
          continue;
        }
        const double* from = mean_.data() + j * columns;
        for (std::size_t c = 0; c < columns; ++c) {
          out[c] -= weight * from[c];
        }
      }
      if (record != nullptr) {
        record->innovation[output] = out[0];
        record->variance[output] = variance;
        for (std::size_t i = 0; i < order_; ++i) {
          record->gain[output * order_ + i] = gain_[i] / variance;
        }
      }
      for (std::size_t c = 0; c < columns; ++c) {
        // The effect of a window's beginning decays so far that its squares would be denormal
        // numbers, with which the processor is a hundred times slower.
        out[c] = std::fabs(out[c]) < kNegligible ? 0.0 : out[c] * scale;
      }
      for (std::size_t i = 0; i < order_; ++i) {
        const double weight = gain_[i] * scale;
        double* to = mean_.data() + i * columns;
        for (std::size_t c = 0; c < columns; ++c) {
          to[c] += weight * out[c];
        }
        double* line = covariance_.data() + i * order_;
        for (std::size_t j = 0; j < order_; ++j) {
          line[j] -= weight * scale * gain_[j];
        }
      }
      log_variances[output] += std::log(variance);
    }
  }

  // From after the measurement of `step` to before the next one: mean and covariance through F =
  // [transition disturbance_input; 0 memory], plus the disturbances' new noise.
  HELI_INLINE void predict(std::size_t step) {
    const std::size_t states = system_.states;
    const std::size_t disturbances = system_.disturbances;
    const std::size_t columns = system_.columns;
    const double* phi = system_.transition + step * states * states;
    const double* input = disturbance_input(step);
    const double* drive = system_.drive + step * states * columns;
    std::copy(drive, drive + states * columns, next_.begin());
    std::fill(product_.begin(), product_.end(), 0.0);
    for (std::size_t i = 0; i < states; ++i) {
      double* weights = gain_.data();
      std::copy(phi + i * states, phi + (i + 1) * states, weights);
      std::copy(input + i * disturbances, input + (i + 1) * disturbances, weights + states);
      add_rows(weights, order_, mean_.data(), columns, next_.data() + i * columns);
      add_rows(weights, order_, covariance_.data(), order_, product_.data() + i * order_);
    }
    // Mean.
    std::copy(next_.begin(), next_.end(), mean_.begin());
    for (std::size_t i = 0; i < disturbances; ++i) {
      double* to = mean_.data() + (states + i) * columns;
      for (std::size_t c = 0; c < columns; ++c) {
        to[c] *= step_memory_[i];
      }
    }
    // Covariance: states with states, states with disturbances, then disturbances.
    for (std::size_t i = 0; i < states; ++i) {
      const double* line = product_.data() + i * order_;
      for (std::size_t k = 0; k <= i; ++k) {
        double sum = 0.0;
        for (std::size_t j = 0; j < states; ++j) {
          sum += line[j] * phi[k * states + j];
        }
        for (std::size_t j = 0; j < disturbances; ++j) {
          sum += line[states + j] * input[k * disturbances + j];
        }
        covariance_[i * order_ + k] = sum;
        covariance_[k * order_ + i] = sum;
      }
      for (std::size_t j = 0; j < disturbances; ++j) {
        const double sum = line[states + j] * step_memory_[j];
        covariance_[i * order_ + states + j] = sum;
        covariance_[(states + j) * order_ + i] = sum;
      }
    }
    for (std::size_t i = 0; i < disturbances; ++i) {
      for (std::size_t j = 0; j < disturbances; ++j) {
        covariance_[(states + i) * order_ + states + j] *= step_memory_[i] * step_memory_[j];
      }
      const double lost = 1.0 - step_memory_[i] * step_memory_[i];
      covariance_[(states + i) * order_ + states + i] += lost * system_.disturbance_variance[i];
    }
  }

  // Response to a unit of each disturbance at the step's beginning, [states][disturbances].
  HELI_INLINE const double* disturbance_input(std::size_t step) {
    const std::size_t kind = system_.kind;
    const std::size_t size = system_.states * kind;
    std::fill(input_.begin(), input_.end(), 0.0);
    for (std::size_t first = 0; first < system_.disturbances; first += kind) {
      for (std::size_t k = 0; k < kind; ++k) {
        double left = 1.0;  // of the disturbance, at the part's beginning
        for (std::size_t part = 0; part < system_.parts; ++part) {
          const double* from = system_.part_input + (part * system_.steps + step) * size + k;
          for (std::size_t i = 0; i < system_.states; ++i) {
            input_[i * system_.disturbances + first + k] += left * from[i * kind];
          }
          left *= system_.memory[first + k];
        }
      }
    }
    return input_.data();
  }

  const std::vector<double>& step_memory() const { return step_memory_; }

  void record_prediction(StepRecord& record) const {
    first_column(record.mean.data());
    record.covariance = covariance_;
  }

  void first_column(double* out) const {
    for (std::size_t i = 0; i < order_; ++i) {
      out[i] = mean_[i * system_.columns];
    }
  }

 private:
  const LinearSystem& system_;
  std::size_t order_;
  std::vector<double> mean_;
  std::vector<double> next_;
  std::vector<double> covariance_;
  std::vector<double> product_;
  std::vector<double> gain_;
  std::vector<double> input_;
  std::vector<double> step_memory_;
};

}  // namespace

HELI_WIDE void filter(const LinearSystem& system, double* innovations, double* log_variances) {
  Filter filter(system);
  std::fill(log_variances, log_variances + system.outputs, 0.0);
  for (std::size_t step = 0; step < system.steps; ++step) {
    filter.update(step, innovations + step * system.outputs * system.columns, log_variances,
                  nullptr);
    if (step + 1 < system.steps) {
      filter.predict(step);
    }
  }
}

void track(const LinearSystem& system, double* predicted, double* filtered) {
  Filter filter(system);
  const std::size_t order = system.states + system.disturbances;
  std::vector<double> unused(system.outputs * system.columns);
  std::vector<double> log_variances(system.outputs, 0.0);
  for (std::size_t step = 0; step < system.steps; ++step) {
    filter.first_column(predicted + step * order);
    filter.update(step, unused.data(), log_variances.data(), nullptr);
    filter.first_column(filtered + step * order);
    if (step + 1 < system.steps) {
      filter.predict(step);
    }
  }
}

namespace {

// Modified Bryson-Frazier smoother: an adjoint vector and its matrix run backwards. Nothing is
// inverted, so disturbances of variance 0 and exactly known states are no special case. G. J.
// Bierman, Automatica 9 (1973) 503. Uses the first column only.
// Calls `visit(step, record, adjoint, matrix)` for each step, the last first.
template <typename Visit>
void backward(const LinearSystem& system, Visit visit) {
  const std::size_t states = system.states;
  const std::size_t order = states + system.disturbances;
  Filter filter(system);
  // Forward pass: the filter, with a record of each step.
  std::vector<StepRecord> records(system.steps);
  std::vector<double> unused(system.outputs * system.columns);
  std::vector<double> log_variances(system.outputs, 0.0);
  for (std::size_t step = 0; step < system.steps; ++step) {
    StepRecord& now = records[step];
    now.mean.resize(order);
    now.gain.resize(system.outputs * order);
    now.innovation.resize(system.outputs);
    now.variance.resize(system.outputs);
    filter.record_prediction(now);
    filter.update(step, unused.data(), log_variances.data(), &now);
    if (step + 1 < system.steps) {
      filter.predict(step);
    }
  }
  // Backward pass.
  std::vector<double> adjoint(order, 0.0);
  std::vector<double> matrix(order * order, 0.0);
  std::vector<double> product(order * order);
  std::vector<double> line(order);
  for (std::size_t step = system.steps; step-- > 0;) {
    if (step + 1 < system.steps) {
      // Back through the prediction: F' adjoint, F' matrix F with F = [transition
      // disturbance_input; 0 memory].
      const double* phi = system.transition + step * states * states;
      const double* input = filter.disturbance_input(step);
      const auto entry = [&](std::size_t i, std::size_t j) {
        if (i < states) {
          return j < states ? phi[i * states + j] : input[i * system.disturbances + j - states];
        }
        return i == j ? filter.step_memory()[i - states] : 0.0;
      };
      for (std::size_t j = 0; j < order; ++j) {
        double sum = 0.0;
        for (std::size_t i = 0; i < order; ++i) {
          sum += entry(i, j) * adjoint[i];
        }
        line[j] = sum;
      }
      adjoint = line;
      for (std::size_t i = 0; i < order; ++i) {
        for (std::size_t j = 0; j < order; ++j) {
          double sum = 0.0;
          for (std::size_t k = 0; k < order; ++k) {
            sum += matrix[i * order + k] * entry(k, j);
          }
          product[i * order + j] = sum;
        }
      }
      for (std::size_t i = 0; i < order; ++i) {
        for (std::size_t j = 0; j < order; ++j) {
          double sum = 0.0;
          for (std::size_t k = 0; k < order; ++k) {
            sum += entry(k, i) * product[k * order + j];
          }
          matrix[i * order + j] = sum;
        }
      }
    }
    const StepRecord& now = records[step];
    // Back through the measurements, the last output first: with row h, gain k, innovation e and
    // its variance v, adjoint' = (I - k h)' adjoint - h e / v and matrix' = (I - k h)' matrix (I -
    // k h) + h' h / v.
    for (std::size_t output = system.outputs; output-- > 0;) {
      if (!(now.variance[output] > 0.0)) {
        continue;
      }
      const double* row = system.measurement + (step * system.outputs + output) * states;
      const double* gain = now.gain.data() + output * order;
      double gain_dot_adjoint = 0.0;
      for (std::size_t i = 0; i < order; ++i) {
        gain_dot_adjoint += gain[i] * adjoint[i];
        double sum = 0.0;
        for (std::size_t j = 0; j < order; ++j) {
          sum += matrix[i * order + j] * gain[j];
        }
        line[i] = sum;
      }
      double quadratic = 0.0;
      for (std::size_t i = 0; i < order; ++i) {
        quadratic += gain[i] * line[i];
      }
      const double inverse = 1.0 / now.variance[output];
      for (std::size_t i = 0; i < states; ++i) {
        adjoint[i] -= row[i] * (gain_dot_adjoint + now.innovation[output] * inverse);
      }
      for (std::size_t i = 0; i < order; ++i) {
        const double own = i < states ? row[i] : 0.0;
        for (std::size_t j = 0; j < order; ++j) {
          const double other = j < states ? row[j] : 0.0;
          matrix[i * order + j] +=
              own * other * (inverse + quadratic) - own * line[j] - line[i] * other;
        }
      }
    }
    visit(step, now, adjoint, matrix);
  }
}

}  // namespace

void smooth(const LinearSystem& system, double* mean, double* variance) {
  const std::size_t order = system.states + system.disturbances;
  std::vector<double> line(order);
  backward(system, [&](std::size_t step, const StepRecord& now, const std::vector<double>& adjoint,
                       const std::vector<double>& matrix) {
    for (std::size_t i = 0; i < order; ++i) {
      double sum = now.mean[i];
      for (std::size_t j = 0; j < order; ++j) {
        sum -= now.covariance[i * order + j] * adjoint[j];
        double inner = 0.0;
        for (std::size_t k = 0; k < order; ++k) {
          inner += matrix[j * order + k] * now.covariance[i * order + k];
        }
        line[j] = inner;
      }
      double reduction = 0.0;
      for (std::size_t j = 0; j < order; ++j) {
        reduction += now.covariance[i * order + j] * line[j];
      }
      mean[step * order + i] = sum;
      variance[step * order + i] = std::max(now.covariance[i * order + i] - reduction, 0.0);
    }
  });
}

// The adjoint before a step's measurement is minus the gradient of the log-likelihood with respect
// to an addition to the state there, and the matrix is the information.
void shock_scores(const LinearSystem& system, double* score, double* information) {
  const std::size_t order = system.states + system.disturbances;
  backward(system, [&](std::size_t step, const StepRecord&, const std::vector<double>& adjoint,
                       const std::vector<double>& matrix) {
    for (std::size_t i = 0; i < order; ++i) {
      score[step * order + i] = -adjoint[i];
      information[step * order + i] = matrix[i * order + i];
    }
  });
}

}  // namespace heli_lab
