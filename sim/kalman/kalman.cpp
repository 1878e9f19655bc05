// Filtering, tracking, and the backward pass of smoother and shock scores; see kalman.hpp. "Order"
// is the number of states and disturbances together; all matrices are row-major.
#include "kalman.hpp"

#include <algorithm>

#include "filter.hpp"

namespace heli_lab {

// The last step has no prediction: its drive is not defined.
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

// Writes the mean before and after each measurement; innovations are not kept.
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

// Runs the filter, and returns the record of each step.
std::vector<StepRecord> forward(const LinearSystem& system, Filter& filter) {
  const std::size_t order = system.states + system.disturbances;
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
  return records;
}

// Adjoint vector of the state, and its matrix, while they run backwards.
struct Adjoint {
  explicit Adjoint(const LinearSystem& of)
      : system(of),
        order(of.states + of.disturbances),
        vector(order, 0.0),
        matrix(order * order, 0.0),
        product(order * order),
        line(order) {}

  // Back through the prediction: F' vector and F' matrix F with F = [transition disturbance_input;
  // 0 memory].
  void through_prediction(std::size_t step, Filter& filter) {
    const std::size_t states = system.states;
    const double* phi = system.transition + step * states * states;
    const double* input = filter.disturbance_input(step);
    // Element (i, j) of F.
    const auto entry = [&](std::size_t i, std::size_t j) {
      if (i < states) {
        return j < states ? phi[i * states + j] : input[i * system.disturbances + j - states];
      }
      return i == j ? filter.step_memory()[i - states] : 0.0;
    };
    for (std::size_t j = 0; j < order; ++j) {
      double sum = 0.0;
      for (std::size_t i = 0; i < order; ++i) {
        sum += entry(i, j) * vector[i];
      }
      line[j] = sum;
    }
    vector = line;
    // product = matrix F, then matrix = F' product.
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

  // Back through one measurement: with row h, gain k, innovation e and its variance v,
  // vector' = (I - k h)' vector - h e / v and matrix' = (I - k h)' matrix (I - k h) + h' h / v.
  void through_measurement(const double* row, const double* gain, double innovation,
                           double variance) {
    const std::size_t states = system.states;
    const double gain_dot_vector = dot(gain, vector.data(), order);
    // Matrix k, and k' matrix k.
    for (std::size_t i = 0; i < order; ++i) {
      line[i] = dot(matrix.data() + i * order, gain, order);
    }
    const double quadratic = dot(gain, line.data(), order);
    // The equations above, multiplied out: h has only entries of states.
    const double inverse = 1.0 / variance;
    for (std::size_t i = 0; i < states; ++i) {
      vector[i] -= row[i] * (gain_dot_vector + innovation * inverse);
    }
    for (std::size_t i = 0; i < order; ++i) {
      const double h_i = i < states ? row[i] : 0.0;
      for (std::size_t j = 0; j < order; ++j) {
        const double h_j = j < states ? row[j] : 0.0;
        matrix[i * order + j] += h_i * h_j * (inverse + quadratic) - h_i * line[j] - line[i] * h_j;
      }
    }
  }

  const LinearSystem& system;
  std::size_t order;
  std::vector<double> vector;   // [order]
  std::vector<double> matrix;   // [order][order]
  std::vector<double> product;  // scratch, [order][order]
  std::vector<double> line;     // scratch, [order]
};

// Modified Bryson-Frazier smoother: an adjoint vector and its matrix run backwards. Nothing is
// inverted, so disturbances of variance 0 and exactly known states are no special case. G. J.
// Bierman, Automatica 9 (1973) 503. Uses the first column only.
// Calls `visit(step, record, adjoint, matrix)` for each step, the last first.
template <typename Visit>
void backward(const LinearSystem& system, Visit visit) {
  Filter filter(system);
  const std::vector<StepRecord> records = forward(system, filter);
  const std::size_t order = system.states + system.disturbances;
  Adjoint adjoint(system);
  for (std::size_t step = system.steps; step-- > 0;) {
    if (step + 1 < system.steps) {
      adjoint.through_prediction(step, filter);
    }
    // The measurements were used one after the other: the last output first.
    const StepRecord& now = records[step];
    for (std::size_t output = system.outputs; output-- > 0;) {
      if (now.variance[output] > 0.0) {
        const std::size_t row = (step * system.outputs + output) * system.states;
        adjoint.through_measurement(system.measurement + row, now.gain.data() + output * order,
                                    now.innovation[output], now.variance[output]);
      }
    }
    visit(step, now, adjoint.vector, adjoint.matrix);
  }
}

}  // namespace

// With predicted mean m and covariance P, and the adjoint l and its matrix L before the
// measurement: the smoothed mean is m - P l, the variance the diagonal of P - P L P.
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
