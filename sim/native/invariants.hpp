// The invariants of firmware/proofs on a simulated flight: what the proofs assume, flights keep.
#pragma once

#include <cstdint>

#include "flight_code.hpp"

namespace heli_sim {

// The claim whose invariant does not hold; null if all hold.
const char* broken_invariant(const heli::FlightCode& code, std::int32_t duty_full);

}  // namespace heli_sim
