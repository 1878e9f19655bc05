// The simplex architecture: an uploaded law flies, and the board's own controller runs in its
// shadow, so that it can take over from one tick to the next (L. Sha, "Using simplicity to control
// complexity", IEEE Software 2001).
#pragma once

#include "control/controller.hpp"
#include "control/controller_table.hpp"
#include "law/uploaded_law.hpp"

namespace heli::law {

class Simplex {
 public:
  Simplex(control::ControllerTable& controllers, UploadedLaw& uploaded)
      : controllers_(controllers), uploaded_(uploaded), active_(&controllers.selected(0)) {}

  const link::ControllerNames& names() const { return controllers_.names(); }

  void derive(control::IdleLoop idle, const params::Params& params, Bank bank) {
    controllers_.derive(idle, params, bank);
    uploaded_.derive(params, bank);
  }

  // In each tick without a law's voltages on the motors, and only here, another controller becomes
  // the active one: none is replaced in flight, whatever the parameters say.
  void init(Bank bank) {
    active_ = &controllers_.selected(bank);
    active_->init();
  }

  ControlOutput update(const ControlInput& in, Bank bank) {
    if (!uploaded_.busy()) {
      return active_->update(in, bank);
    }
    return update_both(in, bank);
  }

 private:
  // A flight with an uploaded law, or the recovery after it. Not inlined, so that update() stays
  // short without one.
  [[gnu::noinline]] ControlOutput update_both(const ControlInput& in, Bank bank) {
    ControlOutput out{};
    if (uploaded_.flying() && uploaded_.update(in, bank, out)) {
      active_->shadow(in, bank, out);
      return out;
    }
    if (!uploaded_.recovery().active()) {
      return active_->update(in, bank);
    }
    ControlInput reachable = in;
    if (uploaded_.recover(reachable, bank)) {
      active_->take_over();
    }
    return active_->update(reachable, bank);
  }

  control::ControllerTable& controllers_;
  UploadedLaw& uploaded_;
  control::Controller* active_;
};

}  // namespace heli::law
