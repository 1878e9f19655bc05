// The core and the laws that it is built with: what a board runs. The one file that names a law.
#pragma once

#include "board.hpp"
#include "control/cascade.hpp"
#include "core.hpp"
#include "law/simplex.hpp"
#include "law/uploaded_law.hpp"

namespace heli {

struct FlightCode {
  explicit FlightCode(Board& board) : simplex(cascade, uploaded), core(board, simplex, uploaded) {}

  control::Cascade cascade;
  law::UploadedLaw uploaded;
  law::Simplex simplex;
  Core core;
};

}  // namespace heli
