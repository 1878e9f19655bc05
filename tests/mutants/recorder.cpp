// Records which blocks of instrumented code have run: the compiler calls the hook at the start of
// each block.
#include <dlfcn.h>

#include <cstdint>
#include <cstring>

namespace {

// A byte for each address of this library: 16 MB is more than it has, and pages that nobody writes
// cost nothing.
constexpr std::uintptr_t kBytes = 1U << 24U;
std::uint8_t reached[kBytes];

std::uintptr_t base() {
  static const std::uintptr_t first = [] {
    Dl_info info;
    return dladdr(reached, &info) != 0 ? reinterpret_cast<std::uintptr_t>(info.dli_fbase) : 0U;
  }();
  return first;
}

}  // namespace

extern "C" {

void __sanitizer_cov_trace_pc() {
  const std::uintptr_t offset =
      reinterpret_cast<std::uintptr_t>(__builtin_return_address(0)) - base();
  if (offset < kBytes) reached[offset] = 1;
}

__attribute__((visibility("default"))) const std::uint8_t* heli_reached() { return reached; }

__attribute__((visibility("default"))) void heli_clear_reached() {
  std::memset(reached, 0, kBytes);
}
}
