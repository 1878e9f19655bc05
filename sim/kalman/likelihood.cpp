#include <algorithm>
#include <cmath>
#include <vector>

#include "kalman.hpp"

namespace heli_lab {
namespace {

constexpr std::size_t kAxes = 3;
constexpr std::size_t kLanes = 4;
// Steps whose variances are multiplied before a logarithm is taken: of variances above 1e-18 rad2
// the product stays in range.
constexpr std::size_t kProduct = 16;

#if defined(__GNUC__)
using Four = double __attribute__((vector_size(kLanes * sizeof(double))));
#else
struct Four {
  double lane[kLanes];
  double& operator[](std::size_t i) { return lane[i]; }
  double operator[](std::size_t i) const { return lane[i]; }
};
#define HELI_FOUR(op)                                                  \
  inline Four operator op(const Four& a, const Four& b) {              \
    return {{a[0] op b[0], a[1] op b[1], a[2] op b[2], a[3] op b[3]}}; \
  }
HELI_FOUR(+)
HELI_FOUR(-)
HELI_FOUR(*)
HELI_FOUR(/)
#undef HELI_FOUR
#endif

// One number of each of four weathers; a structure, because containers drop the alignment of a
// vector.
struct Lanes {
  Four four;
  HELI_INLINE double& operator[](std::size_t i) { return reinterpret_cast<double*>(&four)[i]; }
};

HELI_INLINE Lanes all(double value) { return {Four{value, value, value, value}}; }

#define HELI_LANES(op)                                                                         \
  HELI_INLINE Lanes operator op(const Lanes& a, const Lanes& b) { return {a.four op b.four}; } \
  HELI_INLINE Lanes operator op(const Lanes& a, double b) { return a op all(b); }              \
  HELI_INLINE Lanes operator op(double a, const Lanes& b) { return all(a) op b; }              \
  HELI_INLINE Lanes& operator op## = (Lanes & a, const Lanes& b) { return a = a op b; }
HELI_LANES(+)
HELI_LANES(-)
HELI_LANES(*)
HELI_LANES(/)
#undef HELI_LANES

// Gusts and a drift about each axis.
constexpr std::size_t kTorques = 6;

struct FourWeathers {
  Lanes memory[kTorques];  // of a part
  Lanes step_memory[kTorques];
  Lanes torque_variance[kTorques];
  Lanes scale[kAxes];
};

// Sums over the columns that are kept in registers together.
constexpr std::size_t kTogether = 4;

// out[k] = sum of weights[j] table[j][k], of the first `count` rows.
template <std::size_t kOrder, typename Weight>
HELI_INLINE void combine(const Weight* weights, std::size_t count, const Lanes* table, Lanes* out,
                         bool add) {
  std::size_t k = 0;
  for (; k + kTogether <= kOrder; k += kTogether) {
    Lanes a = add ? out[k] : all(0.0);
    Lanes b = add ? out[k + 1] : all(0.0);
    Lanes c = add ? out[k + 2] : all(0.0);
    Lanes d = add ? out[k + 3] : all(0.0);
    for (std::size_t j = 0; j < count; ++j) {
      const Weight weight = weights[j];
      const Lanes* line = table + j * kOrder + k;
      a += weight * line[0];
      b += weight * line[1];
      c += weight * line[2];
      d += weight * line[3];
    }
    out[k] = a;
    out[k + 1] = b;
    out[k + 2] = c;
    out[k + 3] = d;
  }
  for (; k < kOrder; ++k) {
    Lanes sum = add ? out[k] : all(0.0);
    for (std::size_t j = 0; j < count; ++j) {
      sum += weights[j] * table[j * kOrder + k];
    }
    out[k] = sum;
  }
}

// The filter of kalman.cpp for one column and four weathers at once; the innovations are not kept.
template <std::size_t kStates>
HELI_INLINE void follow(const LinearSystem& system, const FourWeathers& weathers, Lanes* values) {
  constexpr std::size_t kOrder = kStates + kTorques;
  const std::size_t kind = system.kind;
  Lanes mean[kOrder];
  Lanes next[kStates];
  Lanes covariance[kOrder * kOrder];
  Lanes product[kStates * kOrder];
  Lanes gain[kOrder];
  Lanes input[kStates * kTorques];
  Lanes products[kAxes];
  std::fill(mean, mean + kOrder, all(0.0));
  std::fill(covariance, covariance + kOrder * kOrder, all(0.0));
  for (std::size_t i = 0; i < kStates; ++i) {
    covariance[i * (kOrder + 1)] = all(system.initial_variance[i]);
  }
  for (std::size_t i = 0; i < kTorques; ++i) {
    covariance[(kStates + i) * (kOrder + 1)] = weathers.torque_variance[i];
  }
  for (std::size_t axis = 0; axis < kAxes; ++axis) {
    values[axis] = all(0.0);
    products[axis] = all(1.0);
  }
  for (std::size_t step = 0; step < system.steps; ++step) {
    for (std::size_t axis = 0; axis < kAxes; ++axis) {
      const double error = system.measurement_variance[step * kAxes + axis];
      if (!(error > 0.0)) {
        continue;
      }
      const double* row = system.measurement + (step * kAxes + axis) * kStates;
      std::fill(gain, gain + kOrder, all(0.0));
      Lanes innovation = all(system.measured[(step * kAxes + axis) * system.columns]);
      for (std::size_t j = 0; j < kStates; ++j) {
        const double weight = row[j];
        if (weight == 0.0) {
          continue;
        }
        innovation -= weight * mean[j];
        const Lanes* line = covariance + j * kOrder;
        for (std::size_t i = 0; i < kOrder; ++i) {
          gain[i] += weight * line[i];
        }
      }
      Lanes variance = weathers.scale[axis] * error;
      for (std::size_t j = 0; j < kStates; ++j) {
        variance += row[j] * gain[j];
      }
      const Lanes inverse = 1.0 / variance;
      values[axis] -= 0.5 * innovation * innovation * inverse;
      products[axis] *= variance;
      innovation *= inverse;
      for (std::size_t i = 0; i < kOrder; ++i) {
        mean[i] += gain[i] * innovation;
        const Lanes weight = gain[i] * inverse;
        Lanes* line = covariance + i * kOrder;
        for (std::size_t j = 0; j < kOrder; ++j) {
          line[j] -= weight * gain[j];
        }
      }
    }
    if (step % kProduct == kProduct - 1 || step + 1 == system.steps) {
      for (std::size_t axis = 0; axis < kAxes; ++axis) {
        for (std::size_t lane = 0; lane < kLanes; ++lane) {
          values[axis][lane] -= 0.5 * std::log(products[axis][lane]);
        }
        products[axis] = all(1.0);
      }
    }
    if (step + 1 == system.steps) {
      break;
    }
    std::fill(input, input + kStates * kTorques, all(0.0));
    for (std::size_t first = 0; first < kTorques; first += kind) {
      for (std::size_t k = 0; k < kind; ++k) {
        Lanes left = all(1.0);
        for (std::size_t part = 0; part < system.parts; ++part) {
          const double* from =
              system.part_input + (part * system.steps + step) * kStates * kind + k;
          for (std::size_t i = 0; i < kStates; ++i) {
            input[i * kTorques + first + k] += left * from[i * kind];
          }
          left *= weathers.memory[first + k];
        }
      }
    }
    const double* phi = system.transition + step * kStates * kStates;
    for (std::size_t i = 0; i < kStates; ++i) {
      Lanes sum = all(system.drive[(step * kStates + i) * system.columns]);
      for (std::size_t j = 0; j < kStates; ++j) {
        sum += phi[i * kStates + j] * mean[j];
      }
      for (std::size_t j = 0; j < kTorques; ++j) {
        sum += input[i * kTorques + j] * mean[kStates + j];
      }
      next[i] = sum;
      combine<kOrder>(phi + i * kStates, kStates, covariance, product + i * kOrder, false);
      combine<kOrder>(input + i * kTorques, kTorques, covariance + kStates * kOrder,
                      product + i * kOrder, true);
    }
    std::copy(next, next + kStates, mean);
    for (std::size_t i = 0; i < kTorques; ++i) {
      mean[kStates + i] *= weathers.step_memory[i];
    }
    for (std::size_t i = 0; i < kStates; ++i) {
      const Lanes* line = product + i * kOrder;
      for (std::size_t k = 0; k <= i; ++k) {
        Lanes sum = all(0.0);
        for (std::size_t j = 0; j < kStates; ++j) {
          sum += line[j] * phi[k * kStates + j];
        }
        for (std::size_t j = 0; j < kTorques; ++j) {
          sum += line[kStates + j] * input[k * kTorques + j];
        }
        covariance[i * kOrder + k] = sum;
        covariance[k * kOrder + i] = sum;
      }
      for (std::size_t j = 0; j < kTorques; ++j) {
        const Lanes sum = line[kStates + j] * weathers.step_memory[j];
        covariance[i * kOrder + kStates + j] = sum;
        covariance[(kStates + j) * kOrder + i] = sum;
      }
    }
    for (std::size_t i = 0; i < kTorques; ++i) {
      for (std::size_t j = 0; j < kTorques; ++j) {
        covariance[(kStates + i) * kOrder + kStates + j] *=
            weathers.step_memory[i] * weathers.step_memory[j];
      }
      const Lanes lost = 1.0 - weathers.step_memory[i] * weathers.step_memory[i];
      covariance[(kStates + i) * (kOrder + 1)] += lost * weathers.torque_variance[i];
    }
  }
}

// Sizes that are known let the compiler keep sums in registers: gusts and a drift about each axis,
// and up to six states of effects.
HELI_WIDE void follow_any(const LinearSystem& system, const FourWeathers& weathers, Lanes* values) {
  switch (system.states) {
#define HELI_STATES(states)                   \
  case states:                                \
    follow<states>(system, weathers, values); \
    break;
    HELI_STATES(6)
    HELI_STATES(7)
    HELI_STATES(8)
    HELI_STATES(9)
    HELI_STATES(10)
    HELI_STATES(11)
    HELI_STATES(12)
#undef HELI_STATES
    default:
      break;
  }
}

// One weather by the filter that takes any sizes.
void follow_one(LinearSystem system, const double* memory, const double* torque_variance,
                const double* scale, double* values) {
  std::vector<double> variance(system.steps * kAxes);
  for (std::size_t i = 0; i < variance.size(); ++i) {
    variance[i] = system.measurement_variance[i] * scale[i % kAxes];
  }
  system.memory = memory;
  system.torque_variance = torque_variance;
  system.measurement_variance = variance.data();
  std::vector<double> innovations(system.steps * kAxes * system.columns);
  filter(system, innovations.data(), values);
  for (std::size_t axis = 0; axis < kAxes; ++axis) {
    double squares = 0.0;
    for (std::size_t step = 0; step < system.steps; ++step) {
      const double value = innovations[(step * kAxes + axis) * system.columns];
      squares += value * value;
    }
    values[axis] = -0.5 * (values[axis] + squares);
  }
}

}  // namespace

void log_likelihoods(const LinearSystem& system, std::size_t weathers, const double* memory,
                     const double* torque_variance, const double* scale, double* values) {
  const std::size_t torques = system.torques;
  if (torques != kTorques || system.states < 6 || system.states > 12) {
    for (std::size_t i = 0; i < weathers; ++i) {
      follow_one(system, memory + i * torques, torque_variance + i * torques, scale + i * kAxes,
                 values + i * kAxes);
    }
    return;
  }
  FourWeathers four;
  for (std::size_t first = 0; first < weathers; first += kLanes) {
    for (std::size_t lane = 0; lane < kLanes; ++lane) {
      const std::size_t from = std::min(first + lane, weathers - 1);
      for (std::size_t i = 0; i < torques; ++i) {
        four.memory[i][lane] = memory[from * torques + i];
        four.step_memory[i][lane] =
            std::pow(memory[from * torques + i], static_cast<double>(system.parts));
        four.torque_variance[i][lane] = torque_variance[from * torques + i];
      }
      for (std::size_t axis = 0; axis < kAxes; ++axis) {
        four.scale[axis][lane] = scale[from * kAxes + axis];
      }
    }
    Lanes found[kAxes];
    follow_any(system, four, found);
    for (std::size_t lane = 0; lane < std::min(kLanes, weathers - first); ++lane) {
      for (std::size_t axis = 0; axis < kAxes; ++axis) {
        values[(first + lane) * kAxes + axis] = found[axis][lane];
      }
    }
  }
}

}  // namespace heli_lab
