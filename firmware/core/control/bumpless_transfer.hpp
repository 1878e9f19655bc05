// Bumpless transfer from one source of a signal to another.
#pragma once

#include "control/fixed.hpp"
#include "control/math.hpp"
#include "params/params.hpp"

namespace heli::control {

// The difference at the moment of the change is added to the new source and decays to zero.
class BumplessTransfer {
 public:
  Quantity apply(Quantity fresh, Quantity previous, bool changed, Share keep) {
    jump_ = changed ? previous - fresh : shrunk(jump_, keep);
    return fresh + jump_;
  }

  // As if the previous output had been larger by this much.
  void shift(Quantity by) { jump_ += by; }

  void clear() { jump_ = {}; }

 private:
  Quantity jump_;
};

// Share of a jump that remains after one tick. Divides, so for the idle loop only.
inline Share bumpless_keep_of(const params::Params& params) {
  return Share::of(1.0F - one_minus_exp(kTick_s / params.get(link::Param::bumpless_s)));
}

}  // namespace heli::control
