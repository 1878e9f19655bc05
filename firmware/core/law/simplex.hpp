// The simplex architecture: an uploaded law flies, and the board's own law runs in its shadow, so
// that it can take over from one tick to the next (L. Sha, "Using
// simplicity to control complexity", IEEE Software 2001).
#pragma once

#include "control/cascade.hpp"
#include "control/controller.hpp"
#include "law/uploaded_law.hpp"

namespace heli::law {

class Simplex final : public control::Controller {
 public:
  Simplex(control::Cascade& own, UploadedLaw& uploaded) : own_(own), uploaded_(uploaded) {}

  void derive(const params::Params& params, Bank bank) override {
    own_.derive(params, bank);
    uploaded_.derive(params, bank);
  }
  void reset() override { own_.reset(); }
  ControlOutput update(const ControlInput& in, Bank bank) override {
    if (!uploaded_.busy()) {
      return own_.update(in, bank);
    }
    return update_both(in, bank);
  }

 private:
  [[gnu::noinline]] ControlOutput update_both(const ControlInput& in, Bank bank) {
    ControlOutput out{};
    if (uploaded_.flying() && uploaded_.update(in, bank, out)) {
      own_.shadow(in, bank, out);
      return out;
    }
    if (!uploaded_.recovery().active()) {
      return own_.update(in, bank);
    }
    ControlInput reachable = in;
    if (uploaded_.recover(reachable, bank)) {
      own_.clear_transients();
    }
    return own_.update(reachable, bank);
  }

  control::Cascade& own_;
  UploadedLaw& uploaded_;
};

}  // namespace heli::law
