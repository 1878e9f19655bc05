// Taking over a signal without a jump.
#pragma once

#include "control/fixed.hpp"
#include "control/math.hpp"
#include "params/params.hpp"

namespace heli::control {

// What the new source differs by at the moment of the change is added to it and fades out.
class Fade {
 public:
  Quantity apply(Quantity fresh, Quantity previous, bool changed, Share keep) {
    jump_ = changed ? previous - fresh : shrunk(jump_, keep);
    return fresh + jump_;
  }

  // As if the last output had been so much more.
  void shift(Quantity by) { jump_ += by; }

  void forget() { jump_ = {}; }

 private:
  Quantity jump_;
};

// What is left of a jump from one tick to the next. Divides, so for the idle loop.
inline Share bumpless_keep_of(const params::Params& params) {
  return Share::of(1.0F - gone_after(kTick_s / params.get(link::Param::bumpless_s)));
}

}  // namespace heli::control
