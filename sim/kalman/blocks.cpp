// Deviations over blocks of steps, and the implicit midpoint rule; see kalman.hpp.
#include <algorithm>
#include <cmath>
#include <utility>
#include <vector>

#include "kalman.hpp"

namespace heli_lab {

// Steps each block from a deviation of zero: sum = phi sum + gamma rates.
HELI_WIDE void over_blocks(const Signals& signals, std::size_t block, double* out) {
  const std::size_t states = signals.states;
  const std::size_t columns = signals.columns;
  const std::size_t size = states * columns;
  std::vector<double> now(size);
  for (std::size_t first = 0; first + block <= signals.steps; first += block) {
    double* sum = out + first / block * size;
    std::fill(sum, sum + size, 0.0);
    for (std::size_t step = first; step < first + block; ++step) {
      const double* phi = signals.transition + step * states * states;
      const double* gamma = signals.input + step * states * states;
      const double* rates = signals.rates + step * size;
      std::copy(sum, sum + size, now.begin());
      std::fill(sum, sum + size, 0.0);
      for (std::size_t i = 0; i < states; ++i) {
        add_rows(phi + i * states, states, now.data(), columns, sum + i * columns);
        add_rows(gamma + i * states, states, rates, columns, sum + i * columns);
      }
    }
  }
}

// See kalman.hpp: phi is a step's transition, gamma the effect of its rates.
HELI_WIDE void block_response(const Signals& signals, std::size_t block, double* transition,
                              double* parts) {
  const std::size_t states = signals.states;
  const std::size_t columns = signals.columns;
  const std::size_t blocks = signals.steps / block;
  const std::size_t size = states * columns;
  std::vector<double> now(states * std::max(states, columns));
  // table = phi table, for a table of `width` columns.
  const auto advance = [&](const double* phi, double* table, std::size_t width) {
    std::copy(table, table + states * width, now.begin());
    std::fill(table, table + states * width, 0.0);
    for (std::size_t i = 0; i < states; ++i) {
      add_rows(phi + i * states, states, now.data(), width, table + i * width);
    }
  };
  // Every step advances the block's transition and the deviations of the steps before it, then adds
  // its own.
  for (std::size_t number = 0; number < blocks; ++number) {
    double* over = transition + number * states * states;
    for (std::size_t i = 0; i < states * states; ++i) {
      over[i] = i % (states + 1) == 0 ? 1.0 : 0.0;
    }
    for (std::size_t step = 0; step < block; ++step) {
      const double* phi = signals.transition + (number * block + step) * states * states;
      const double* gamma = signals.input + (number * block + step) * states * states;
      const double* rates = signals.rates + (number * block + step) * size;
      advance(phi, over, states);
      for (std::size_t before = 0; before < step; ++before) {
        advance(phi, parts + (before * blocks + number) * size, columns);
      }
      double* own = parts + (step * blocks + number) * size;
      std::fill(own, own + size, 0.0);
      for (std::size_t i = 0; i < states; ++i) {
        add_rows(gamma + i * states, states, rates, columns, own + i * columns);
      }
    }
  }
}

namespace {

// Turns `inverse`, which is I, into the inverse of `left`, which becomes I: Gauss-Jordan
// elimination with partial pivoting. Both are [size][size].
HELI_INLINE void invert(double* left, double* inverse, std::size_t size) {
  for (std::size_t column = 0; column < size; ++column) {
    std::size_t pivot = column;
    for (std::size_t i = column + 1; i < size; ++i) {
      if (std::fabs(left[i * size + column]) > std::fabs(left[pivot * size + column])) {
        pivot = i;
      }
    }
    if (pivot != column) {
      for (std::size_t k = 0; k < size; ++k) {
        std::swap(left[pivot * size + k], left[column * size + k]);
        std::swap(inverse[pivot * size + k], inverse[column * size + k]);
      }
    }
    const double scale = 1.0 / left[column * size + column];
    for (std::size_t k = 0; k < size; ++k) {
      left[column * size + k] *= scale;
      inverse[column * size + k] *= scale;
    }
    for (std::size_t i = 0; i < size; ++i) {
      const double factor = left[i * size + column];
      if (i != column && factor != 0.0) {
        add_multiple(-factor, left + column * size, size, left + i * size);
        add_multiple(-factor, inverse + column * size, size, inverse + i * size);
      }
    }
  }
}

}  // namespace

// With A the Jacobian and h the step, the transition is (I - h A / 2)^-1 (I + h A / 2) and the
// input matrix is h (I - h A / 2)^-1.
HELI_WIDE void midpoint(const double* jacobian, std::size_t steps, std::size_t states,
                        double step_s, double* transition, double* input) {
  // `input` first holds the inverse of I - h A / 2, which is `left`.
  std::vector<double> left(states * states);
  for (std::size_t step = 0; step < steps; ++step) {
    const double* a = jacobian + step * states * states;
    double* inverse = input + step * states * states;
    for (std::size_t i = 0; i < states * states; ++i) {
      const double one = i % (states + 1) == 0 ? 1.0 : 0.0;
      left[i] = one - 0.5 * step_s * a[i];
      inverse[i] = one;
    }
    invert(left.data(), inverse, states);
    double* phi = transition + step * states * states;
    for (std::size_t i = 0; i < states * states; ++i) {
      // (I - h A / 2)^-1 (I + h A / 2) = 2 (I - h A / 2)^-1 - I
      phi[i] = 2.0 * inverse[i] - (i % (states + 1) == 0 ? 1.0 : 0.0);
      inverse[i] *= step_s;
    }
  }
}

}  // namespace heli_lab
