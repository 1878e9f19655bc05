// Log-likelihoods under several disturbance models in one pass; see kalman.hpp.
#include <algorithm>
#include <cmath>
#include <vector>

#include "kalman.hpp"

namespace heli_lab {
namespace {

constexpr std::size_t kLanes = 4;  // models that are filtered together
// Steps whose variances are multiplied before a logarithm is taken: of variances above 1e-18 rad2
// the product stays in range.
constexpr std::size_t kProduct = 16;

// Four numbers on which the processor computes at once.
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

// One number of each of four models of the disturbances; a structure, because containers drop the
// alignment of a vector.
struct Lanes {
  Four four;
  HELI_INLINE double& operator[](std::size_t i) { return reinterpret_cast<double*>(&four)[i]; }
};

// The same number for all four models.
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

// Sizes that are known let the compiler keep sums in registers.
constexpr std::size_t kMaxOutputs = 3;
constexpr std::size_t kMaxGains = 2;
constexpr std::size_t kMaxDisturbances = 2 * (kMaxOutputs + kMaxGains);

// The disturbance models of four lanes, and the scales of their measurement variances.
struct FourModels {
  Lanes memory[kMaxDisturbances];       // of a part
  Lanes step_memory[kMaxDisturbances];  // of a step
  Lanes disturbance_variance[kMaxDisturbances];
  Lanes scale[kMaxOutputs];
};

// Sums over the columns that are kept in registers together.
constexpr std::size_t kTogether = 4;

// out[k] = sum of weights[j] table[j][k], of the first `count` rows; with `add`, added to out[k].
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

// The filter of filter.hpp for one column and four models of the disturbances at once; a fast and a
// slow one for each output and gain. The innovations are not kept.
template <std::size_t kOutputs, std::size_t kStates, std::size_t kGains>
class FourFilters {
 public:
  HELI_INLINE FourFilters(const LinearSystem& system, const FourModels& models)
      : system_(system), models_(models) {
    std::fill(mean_, mean_ + kOrder, all(0.0));
    std::fill(covariance_, covariance_ + kOrder * kOrder, all(0.0));
    for (std::size_t i = 0; i < kStates; ++i) {
      covariance_[i * (kOrder + 1)] = all(system.initial_variance[i]);
    }
    for (std::size_t i = 0; i < kDisturbances; ++i) {
      covariance_[(kStates + i) * (kOrder + 1)] = models.disturbance_variance[i];
    }
    std::fill(variance_products_, variance_products_ + kOutputs, all(1.0));
  }

  // Measurement update, one output after the other. Adds the part of the innovations' squares to
  // the log-likelihoods, [outputs].
  HELI_INLINE void update(std::size_t step, Lanes* log_likelihoods) {
    for (std::size_t output = 0; output < kOutputs; ++output) {
      const double error = system_.measurement_variance[step * kOutputs + output];
      if (!(error > 0.0)) {
        continue;  // nothing was measured
      }
      const double* row = system_.measurement + (step * kOutputs + output) * kStates;
      // Covariance of the output with each state, P h', and the innovation, measured - h mean.
      std::fill(gain_, gain_ + kOrder, all(0.0));
      Lanes innovation = all(system_.measured[(step * kOutputs + output) * system_.columns]);
      for (std::size_t j = 0; j < kStates; ++j) {
        const double weight = row[j];
        if (weight == 0.0) {
          continue;
        }
        innovation -= weight * mean_[j];
        const Lanes* line = covariance_ + j * kOrder;
        for (std::size_t i = 0; i < kOrder; ++i) {
          gain_[i] += weight * line[i];
        }
      }
      Lanes variance = models_.scale[output] * error;
      for (std::size_t j = 0; j < kStates; ++j) {
        variance += row[j] * gain_[j];
      }
      const Lanes inverse = 1.0 / variance;
      log_likelihoods[output] -= 0.5 * innovation * innovation * inverse;
      variance_products_[output] *= variance;
      // mean += K innovation and P -= K h P.
      innovation *= inverse;
      for (std::size_t i = 0; i < kOrder; ++i) {
        mean_[i] += gain_[i] * innovation;
        const Lanes weight = gain_[i] * inverse;
        Lanes* line = covariance_ + i * kOrder;
        for (std::size_t j = 0; j < kOrder; ++j) {
          line[j] -= weight * gain_[j];
        }
      }
    }
  }

  // Adds the part of the variances since the last call to the log-likelihoods, [outputs].
  HELI_INLINE void take_logarithms(Lanes* log_likelihoods) {
    for (std::size_t output = 0; output < kOutputs; ++output) {
      for (std::size_t lane = 0; lane < kLanes; ++lane) {
        log_likelihoods[output][lane] -= 0.5 * std::log(variance_products_[output][lane]);
      }
      variance_products_[output] = all(1.0);
    }
  }

  // Time update: mean and covariance through F, plus the disturbances' new noise.
  HELI_INLINE void predict(std::size_t step) {
    set_disturbance_input(step);
    const double* phi = system_.transition + step * kStates * kStates;
    Lanes next[kStates];  // the states' rows of F mean + drive
    for (std::size_t i = 0; i < kStates; ++i) {
      Lanes sum = all(system_.drive[(step * kStates + i) * system_.columns]);
      for (std::size_t j = 0; j < kStates; ++j) {
        sum += phi[i * kStates + j] * mean_[j];
      }
      for (std::size_t j = 0; j < kDisturbances; ++j) {
        sum += input_[i * kDisturbances + j] * mean_[kStates + j];
      }
      next[i] = sum;
      combine<kOrder>(phi + i * kStates, kStates, covariance_, product_ + i * kOrder, false);
      combine<kOrder>(input_ + i * kDisturbances, kDisturbances, covariance_ + kStates * kOrder,
                      product_ + i * kOrder, true);
    }
    std::copy(next, next + kStates, mean_);
    for (std::size_t i = 0; i < kDisturbances; ++i) {
      mean_[kStates + i] *= models_.step_memory[i];
    }
    propagate_covariance(phi);
  }

 private:
  static constexpr std::size_t kDisturbances = 2 * (kOutputs + kGains);
  static constexpr std::size_t kOrder = kStates + kDisturbances;

  // Effect of each disturbance on the states, over the parts of the step.
  HELI_INLINE void set_disturbance_input(std::size_t step) {
    const std::size_t kind = system_.kind;
    std::fill(input_, input_ + kStates * kDisturbances, all(0.0));
    for (std::size_t first = 0; first < kDisturbances; first += kind) {
      for (std::size_t k = 0; k < kind; ++k) {
        Lanes remaining = all(1.0);  // of the disturbance, at the part's beginning
        for (std::size_t part = 0; part < system_.parts; ++part) {
          const double* from =
              system_.part_input + (part * system_.steps + step) * kStates * kind + k;
          for (std::size_t i = 0; i < kStates; ++i) {
            input_[i * kDisturbances + first + k] += remaining * from[i * kind];
          }
          remaining *= models_.memory[first + k];
        }
      }
    }
  }

  // The covariance becomes F P F', from the product F P, plus the disturbances' new noise.
  HELI_INLINE void propagate_covariance(const double* phi) {
    for (std::size_t i = 0; i < kStates; ++i) {
      const Lanes* line = product_ + i * kOrder;
      for (std::size_t k = 0; k <= i; ++k) {
        Lanes sum = all(0.0);
        for (std::size_t j = 0; j < kStates; ++j) {
          sum += line[j] * phi[k * kStates + j];
        }
        for (std::size_t j = 0; j < kDisturbances; ++j) {
          sum += line[kStates + j] * input_[k * kDisturbances + j];
        }
        covariance_[i * kOrder + k] = sum;
        covariance_[k * kOrder + i] = sum;
      }
      for (std::size_t j = 0; j < kDisturbances; ++j) {
        const Lanes element = line[kStates + j] * models_.step_memory[j];
        covariance_[i * kOrder + kStates + j] = element;
        covariance_[(kStates + j) * kOrder + i] = element;
      }
    }
    for (std::size_t i = 0; i < kDisturbances; ++i) {
      for (std::size_t j = 0; j < kDisturbances; ++j) {
        covariance_[(kStates + i) * kOrder + kStates + j] *=
            models_.step_memory[i] * models_.step_memory[j];
      }
      const Lanes lost = 1.0 - models_.step_memory[i] * models_.step_memory[i];
      covariance_[(kStates + i) * (kOrder + 1)] += lost * models_.disturbance_variance[i];
    }
  }

  const LinearSystem& system_;
  const FourModels& models_;
  Lanes mean_[kOrder];
  Lanes covariance_[kOrder * kOrder];
  Lanes product_[kStates * kOrder];  // the states' rows of F covariance
  Lanes gain_[kOrder];               // scratch
  Lanes input_[kStates * kDisturbances];
  Lanes variance_products_[kOutputs];  // of the innovations, since take_logarithms()
};

// Filters all steps, and writes the log-likelihood of each output. The logarithms of a few
// variances are taken together.
template <std::size_t kOutputs, std::size_t kStates, std::size_t kGains>
HELI_INLINE void follow(const LinearSystem& system, const FourModels& models,
                        Lanes* log_likelihoods) {
  FourFilters<kOutputs, kStates, kGains> filters(system, models);
  std::fill(log_likelihoods, log_likelihoods + kOutputs, all(0.0));
  for (std::size_t step = 0; step < system.steps; ++step) {
    filters.update(step, log_likelihoods);
    const bool is_last = step + 1 == system.steps;
    if (is_last || step % kProduct == kProduct - 1) {
      filters.take_logarithms(log_likelihoods);
    }
    if (!is_last) {
      filters.predict(step);
    }
  }
}

// follow() is compiled for these sizes: three outputs, their positions and rates as states, and up
// to `kMaxExtra` more states.
constexpr std::size_t kFollowed = 2 * kMaxOutputs;
constexpr std::size_t kMaxExtra = 6;

// Chooses follow() by the number of states.
template <std::size_t kGains>
HELI_INLINE void follow_states(const LinearSystem& system, const FourModels& models,
                               Lanes* values) {
  switch (system.states - kFollowed) {
#define HELI_EXTRA(extra)                                                   \
  case extra:                                                               \
    follow<kMaxOutputs, kFollowed + extra, kGains>(system, models, values); \
    break;
    HELI_EXTRA(0)
    HELI_EXTRA(1)
    HELI_EXTRA(2)
    HELI_EXTRA(3)
    HELI_EXTRA(4)
    HELI_EXTRA(5)
    HELI_EXTRA(kMaxExtra)
#undef HELI_EXTRA
    default:
      break;
  }
}

// Chooses follow() by the number of disturbances: with or without those of the gains.
HELI_WIDE void follow_any(const LinearSystem& system, const FourModels& models, Lanes* values) {
  if (system.disturbances == kMaxDisturbances) {
    follow_states<kMaxGains>(system, models, values);
  } else {
    follow_states<0>(system, models, values);
  }
}

// Whether follow_any() has code for the system's sizes.
bool is_compiled(const LinearSystem& system) {
  return system.outputs == kMaxOutputs &&
         (system.disturbances == 2 * kMaxOutputs || system.disturbances == kMaxDisturbances) &&
         system.states >= kFollowed && system.states <= kFollowed + kMaxExtra;
}

// The log-likelihood of one model, by the filter for any sizes.
void follow_one(LinearSystem system, const double* memory, const double* disturbance_variance,
                const double* scale, double* values) {
  std::vector<double> variance(system.steps * system.outputs);
  for (std::size_t i = 0; i < variance.size(); ++i) {
    variance[i] = system.measurement_variance[i] * scale[i % system.outputs];
  }
  system.memory = memory;
  system.disturbance_variance = disturbance_variance;
  system.measurement_variance = variance.data();
  std::vector<double> innovations(system.steps * system.outputs * system.columns);
  filter(system, innovations.data(), values);
  for (std::size_t output = 0; output < system.outputs; ++output) {
    double squares = 0.0;
    for (std::size_t step = 0; step < system.steps; ++step) {
      const double value = innovations[(step * system.outputs + output) * system.columns];
      squares += value * value;
    }
    values[output] = -0.5 * (values[output] + squares);
  }
}

}  // namespace

// Four models at a time if the sizes allow it, otherwise one after the other.
void log_likelihoods(const LinearSystem& system, std::size_t models, const double* memory,
                     const double* disturbance_variance, const double* scale, double* values) {
  const std::size_t disturbances = system.disturbances;
  if (!is_compiled(system)) {
    for (std::size_t i = 0; i < models; ++i) {
      follow_one(system, memory + i * disturbances, disturbance_variance + i * disturbances,
                 scale + i * system.outputs, values + i * system.outputs);
    }
    return;
  }
  FourModels four;
  for (std::size_t first = 0; first < models; first += kLanes) {
    for (std::size_t lane = 0; lane < kLanes; ++lane) {
      // Lanes behind the last model repeat it.
      const std::size_t from = std::min(first + lane, models - 1);
      for (std::size_t i = 0; i < disturbances; ++i) {
        four.memory[i][lane] = memory[from * disturbances + i];
        four.step_memory[i][lane] =
            std::pow(memory[from * disturbances + i], static_cast<double>(system.parts));
        four.disturbance_variance[i][lane] = disturbance_variance[from * disturbances + i];
      }
      for (std::size_t output = 0; output < system.outputs; ++output) {
        four.scale[output][lane] = scale[from * system.outputs + output];
      }
    }
    Lanes likelihoods[kMaxOutputs];
    follow_any(system, four, likelihoods);
    for (std::size_t lane = 0; lane < std::min(kLanes, models - first); ++lane) {
      for (std::size_t output = 0; output < system.outputs; ++output) {
        values[(first + lane) * system.outputs + output] = likelihoods[output][lane];
      }
    }
  }
}

}  // namespace heli_lab
