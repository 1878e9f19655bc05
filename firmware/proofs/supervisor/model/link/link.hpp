// What the proofs of the flight states put in place of the link: events go nowhere.
#pragma once

#include <cstdint>

#include "link/dispatch.hpp"

namespace heli::link {

class Link {
 public:
  void push_event(const EventMessage&) {}
};

}  // namespace heli::link
