// Kalman filter and fixed-interval smoother of a linear time-varying system that torques by chance
// drive.
#pragma once

#include <cstddef>
#include <vector>

namespace heli_lab {

// e' = transition e + torque_input w + drive, w' = memory w + noise, y = measurement e + error.
// Matrices are row-major, one a step; `columns` signals share the gains, because filtering is
// linear.
struct LinearSystem {
  std::size_t steps = 0;
  std::size_t states = 0;
  std::size_t torques = 0;
  std::size_t columns = 0;
  const double* transition = nullptr;            // [steps][states][states]
  const double* torque_input = nullptr;          // [steps][states][torques]
  const double* measurement = nullptr;           // [steps][3][states]
  const double* measurement_variance = nullptr;  // [steps][3]; 0 where nothing was measured
  const double* memory = nullptr;                // [torques]
  const double* torque_variance = nullptr;       // [torques], stationary
  const double* initial_variance = nullptr;      // [states]
  const double* drive = nullptr;                 // [steps][states][columns]
  const double* measured = nullptr;              // [steps][3][columns]
};

// Writes the innovations in their standard deviations, [steps][3][columns], and for each axis the
// sum of the logarithms of their variances, [3].
void filter(const LinearSystem& system, double* innovations, double* log_variances);

// Mean of state and torques at each step by the first column, before and after the step's
// measurement, [steps][states + torques] each.
void track(const LinearSystem& system, double* predicted, double* filtered);

// Smooths the first column: mean and variance of state and torques at each step, [steps][states +
// torques].
void smooth(const LinearSystem& system, double* mean, double* variance);

}  // namespace heli_lab
