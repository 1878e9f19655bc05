// The core and the laws that it is built with: what a board runs. The one file that names a law.
#pragma once

#include "board.hpp"
#include "control/cascade.hpp"
#include "core.hpp"

namespace heli {

struct FlightCode {
  explicit FlightCode(Board& board) : core(board, cascade) {}

  control::Cascade cascade;
  Core core;
};

}  // namespace heli
