// The core and the laws that it is built with: what a board runs. The one file that names a law.
#pragma once

#include "board.hpp"
#include "control/cascade.hpp"
#include "core.hpp"
#include "law/guest.hpp"
#include "law/simplex.hpp"

namespace heli {

struct FlightCode {
  explicit FlightCode(Board& board) : simplex(cascade, guest), core(board, simplex, guest) {}

  control::Cascade cascade;
  law::Guest guest;
  law::Simplex simplex;
  Core core;
};

}  // namespace heli
