// One value of the true random number generator (datasheet, section 42).
#include "drivers.hpp"
#include "registers.hpp"

namespace heli::due::random {
namespace {

constexpr std::uint32_t kKey = TRNG_CR_KEY(0x524E47);
// A poll takes six cycles or more, a new value 84 cycles.
constexpr std::uint32_t kMaxPolls = 100;

}  // namespace

std::uint32_t bits() {
  PMC->PMC_PCER1.write(bit(ID_TRNG - 32));
  TRNG->TRNG_CR.write(kKey | TRNG_CR_ENABLE);
  for (std::uint32_t i = 0; i < kMaxPolls && (TRNG->TRNG_ISR.read() & TRNG_ISR_DATRDY) == 0U; ++i) {
  }
  const std::uint32_t value = TRNG->TRNG_ODATA.read();
  TRNG->TRNG_CR.write(kKey);
  return value;
}

}  // namespace heli::due::random
