// One millisecond of the rig, whatever computes it.
#pragma once

#include <cstddef>
#include <string>
#include <vector>

namespace heli_sim {

// (state, voltages, locked, parameters) -> (state after the step, measured angles). `locked` is 1
// for each axis that cannot move.
class PlantStep {
 public:
  virtual ~PlantStep() = default;
  virtual void step(const double* state, const double* volts_V, const double* locked,
                    const double* parameters, double* next_state, double* angles_rad) = 0;
  virtual std::size_t state_count() const = 0;
  virtual std::size_t parameter_count() const = 0;
};

// A function that CasADi generated as C, loaded from a shared library.
class CompiledStep : public PlantStep {
 public:
  // Throws std::runtime_error when the library does not hold such a function.
  CompiledStep(const std::string& library, const std::string& name);
  ~CompiledStep() override;
  CompiledStep(const CompiledStep&) = delete;
  CompiledStep& operator=(const CompiledStep&) = delete;

  void step(const double* state, const double* volts_V, const double* locked,
            const double* parameters, double* next_state, double* angles_rad) override;
  std::size_t state_count() const override { return state_count_; }
  std::size_t parameter_count() const override { return parameter_count_; }

 private:
  using Integer = long long;  // casadi_int
  using Function = int (*)(const double**, double**, Integer*, double*, int);

  void* symbol(const std::string& name) const;
  std::size_t dense_size(const Integer* sparsity) const;

  std::string library_;
  void* handle_ = nullptr;
  Function function_ = nullptr;
  std::size_t state_count_ = 0;
  std::size_t parameter_count_ = 0;
  std::vector<const double*> arguments_;
  std::vector<double*> results_;
  std::vector<Integer> integer_work_;
  std::vector<double> real_work_;
};

}  // namespace heli_sim
