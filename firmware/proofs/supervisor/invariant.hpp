// What the proofs of the supervisor assume before a call and prove after it.
#pragma once

#include "flight/supervisor.hpp"

namespace heli::proofs {

inline bool has_fault(link::State state) {
  return state == link::State::fault || state == link::State::emergency_landing;
}

// A fault has a reason, and nothing else has; an excitation runs only where a host may start one.
inline bool holds(const flight::Supervisor& supervisor) {
  const link::State state = supervisor.state_;
  return static_cast<std::size_t>(state) < link::kStateCount &&
         (supervisor.fault_ != link::Fault::none) == has_fault(state) &&
         supervisor.bucket_ < flight::Supervisor::kRateBuckets &&
         (supervisor.exciter_.kind_ == link::Excitation::none ||
          state == link::State::closed_loop || state == link::State::open_loop ||
          state == link::State::streamed);
}

}  // namespace heli::proofs
