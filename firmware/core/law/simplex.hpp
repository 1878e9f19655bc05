// Two laws in one seat: the one that came over the link, and the board's own, which flies otherwise
// and runs in its shadow so that it can take over from one tick to the next (L. Sha, "Using
// simplicity to control complexity", IEEE Software 2001).
#pragma once

#include "control/cascade.hpp"
#include "control/controller.hpp"
#include "law/guest.hpp"

namespace heli::law {

class Simplex final : public control::Controller {
 public:
  Simplex(control::Cascade& own, Guest& guest) : own_(own), guest_(guest) {}

  void derive(const params::Params& params, Bank bank) override {
    own_.derive(params, bank);
    guest_.derive(params, bank);
  }
  void reset() override { own_.reset(); }
  ControlOutput update(const ControlInput& in, Bank bank) override {
    if (!guest_.busy()) {
      return own_.update(in, bank);
    }
    return update_both(in, bank);
  }

 private:
  [[gnu::noinline]] ControlOutput update_both(const ControlInput& in, Bank bank) {
    ControlOutput out{};
    if (guest_.flying() && guest_.update(in, bank, out)) {
      own_.shadow(in, bank, out);
      return out;
    }
    if (!guest_.recovery().active()) {
      return own_.update(in, bank);
    }
    ControlInput reachable = in;
    if (guest_.recover(reachable, bank)) {
      own_.forget_jumps();
    }
    return own_.update(reachable, bank);
  }

  control::Cascade& own_;
  Guest& guest_;
};

}  // namespace heli::law
