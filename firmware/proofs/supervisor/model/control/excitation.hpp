// What the proofs of the supervisor put in place of the excitation: whether it runs, and which.
#pragma once

#include "control/fixed.hpp"
#include "link/declaration.hpp"

namespace heli::control {

class Exciter {
 public:
  void start(const link::ExciteMessage& message) {
    kind_ = static_cast<link::Excitation>(message.kind);
  }
  void stop() { kind_ = link::Excitation::none; }
  bool running() const { return kind_ != link::Excitation::none; }
  link::Excitation kind() const { return kind_; }

 private:
  link::Excitation kind_ = link::Excitation::none;
};

}  // namespace heli::control
