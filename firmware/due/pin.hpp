// A pin of the chip.
#pragma once

#include <cstdint>

#include "registers.hpp"

namespace heli::due {

struct Pin {
  At<Pio> port;
  unsigned number;
  constexpr std::uint32_t mask() const { return bit(number); }
  // Its mask if it is on this port, otherwise none.
  constexpr std::uint32_t mask_on(At<Pio> other) const {
    return port.address == other.address ? mask() : 0U;
  }
};

}  // namespace heli::due
