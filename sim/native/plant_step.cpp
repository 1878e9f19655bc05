// Loads a step function that CasADi has generated and calls it; see plant_step.hpp. Next to
// function NAME the library has NAME_sparsity_in, NAME_sparsity_out and NAME_work, which describe
// its arguments.
#include "plant_step.hpp"

#include <stdexcept>

#if defined(_WIN32)
#define WIN32_LEAN_AND_MEAN
#include <windows.h>
#else
#include <dlfcn.h>
#endif

namespace heli_sim {

namespace {

// The system's own calls behind one name each.
#if defined(_WIN32)
void* open_library(const std::string& path) {
  return reinterpret_cast<void*>(LoadLibraryA(path.c_str()));
}
void* find_symbol(void* library, const std::string& name) {
  return reinterpret_cast<void*>(GetProcAddress(static_cast<HMODULE>(library), name.c_str()));
}
void close_library(void* library) { FreeLibrary(static_cast<HMODULE>(library)); }
std::string library_error() { return "error " + std::to_string(GetLastError()); }
#else
void* open_library(const std::string& path) { return dlopen(path.c_str(), RTLD_NOW | RTLD_LOCAL); }
void* find_symbol(void* library, const std::string& name) { return dlsym(library, name.c_str()); }
void close_library(void* library) { dlclose(library); }
std::string library_error() { return dlerror(); }
#endif

}  // namespace

// Loads the library, checks the sizes of inputs and outputs, and allocates the function's work
// space.
CompiledStep::CompiledStep(const std::string& library, const std::string& name)
    : library_(library) {
  handle_ = open_library(library);
  if (handle_ == nullptr) {
    throw std::runtime_error("the compiled plant does not load: " + library_error() +
                             "; delete it, it is built again");
  }
  try {
    using Sparsity = const Integer* (*)(Integer);
    using Work = int (*)(Integer*, Integer*, Integer*, Integer*);
    function_ = reinterpret_cast<Function>(symbol(name));
    const auto in = reinterpret_cast<Sparsity>(symbol(name + "_sparsity_in"));
    const auto out = reinterpret_cast<Sparsity>(symbol(name + "_sparsity_out"));
    const auto work = reinterpret_cast<Work>(symbol(name + "_work"));

    // Inputs: state, voltages, locked, parameters; outputs: state, angles.
    state_count_ = dense_size(in(0));
    parameter_count_ = dense_size(in(3));
    if (dense_size(in(1)) != 2 || dense_size(in(2)) != 3 || dense_size(out(0)) != state_count_ ||
        dense_size(out(1)) != 3) {
      throw std::runtime_error("the compiled plant " + library_ +
                               " has other inputs or outputs; delete it, it is built again");
    }
    Integer arguments = 0;
    Integer results = 0;
    Integer integers = 0;
    Integer reals = 0;
    work(&arguments, &results, &integers, &reals);
    arguments_.resize(static_cast<std::size_t>(arguments));
    results_.resize(static_cast<std::size_t>(results));
    integer_work_.resize(static_cast<std::size_t>(integers));
    real_work_.resize(static_cast<std::size_t>(reals));
  } catch (...) {
    close_library(handle_);
    throw;
  }
}

CompiledStep::~CompiledStep() { close_library(handle_); }

// The address of a function in the library; throws if it has none.
void* CompiledStep::symbol(const std::string& name) const {
  void* address = find_symbol(handle_, name);
  if (address == nullptr) {
    throw std::runtime_error("the compiled plant " + library_ + " lacks " + name +
                             "; delete it, it is built again");
  }
  return address;
}

// The number of elements of an input or output; throws if its vector is sparse.
std::size_t CompiledStep::dense_size(const Integer* sparsity) const {
  // CasADi's compressed columns: rows, columns, then 1 for dense or the column offsets.
  const Integer size = sparsity[0] * sparsity[1];
  const bool dense = sparsity[2] == 1 || sparsity[2 + sparsity[1]] == size;
  if (!dense) {
    throw std::runtime_error("the compiled plant " + library_ +
                             " has a sparse vector; make it dense");
  }
  return static_cast<std::size_t>(size);
}

// See plant_step.hpp; the last argument is CasADi's memory number.
void CompiledStep::step(const double* state, const double* volts_V, const double* locked,
                        const double* parameters, double* next_state, double* angles_rad) {
  arguments_[0] = state;
  arguments_[1] = volts_V;
  arguments_[2] = locked;
  arguments_[3] = parameters;
  results_[0] = next_state;
  results_[1] = angles_rad;
  function_(arguments_.data(), results_.data(), integer_work_.data(), real_work_.data(), 0);
}

}  // namespace heli_sim
