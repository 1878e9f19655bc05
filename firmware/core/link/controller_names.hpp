// Names of the compiled controllers, as the host reads them.
#pragma once

#include <cstddef>

#include "link/declaration.hpp"

namespace heli::link {

struct ControllerNames {
  static constexpr auto kMax =
      static_cast<std::size_t>(kParams[static_cast<std::size_t>(Param::controller)].max) + 1U;
  static constexpr std::size_t kCharacters = 16;  // of a name on the wire

  const char* name[kMax] = {};
  std::size_t count = 0;
};

}  // namespace heli::link
