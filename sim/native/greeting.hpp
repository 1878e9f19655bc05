// Asks a board for its versions (hello and welcome of the link), before anything is simulated with
// it.
#pragma once

#include <cstdint>
#include <optional>

#include "sim_board.hpp"

namespace heli_sim {

// Lets up to `max_ms` milliseconds of the board's time pass. Empty when it does not answer.
std::optional<heli::link::WelcomeMessage> greet(SimBoard& board, std::uint32_t max_ms);

}  // namespace heli_sim
