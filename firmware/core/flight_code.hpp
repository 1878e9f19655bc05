// The core and the controllers that it is built with: what a board runs. The one file that names a
// controller.
#pragma once

#include "board.hpp"
#include "control/cascade.hpp"
#include "control/controller_table.hpp"
#include "core.hpp"
#include "law/simplex.hpp"
#include "law/uploaded_law.hpp"

namespace heli {

struct FlightCode {
  explicit FlightCode(Board& board) : core(board, simplex, uploaded) {}

  control::Cascade cascade;

  // The parameter `controller` selects a row; row 0 is the default.
  control::ControllerTable controllers{{
      {"cascade", cascade},
  }};

  law::UploadedLaw uploaded;
  law::Simplex simplex{controllers, uploaded};
  Core core;
};

}  // namespace heli
