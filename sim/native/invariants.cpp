// Checks the invariants on the objects of a running flight code. Compiled without access control,
// because the invariants use private members.
#include "invariants.hpp"

#include <atomic>

namespace heli::proofs {

// In a proof, an atomic is a variable of the model; here it is one that the flight code shares.
template <class T>
T value_of(const std::atomic<T>& shared) {
  return shared.load(std::memory_order_relaxed);
}

}  // namespace heli::proofs

#include "duty/invariant.hpp"
#include "exchange/invariant.hpp"
#include "interpreter/invariant.hpp"
#include "mixer/invariant.hpp"
#include "parser/invariant.hpp"
#include "setpoints/invariant.hpp"
#include "supervisor/invariant.hpp"
#include "upload/invariant.hpp"
#include "verifier/invariant.hpp"

namespace heli_sim {

// See invariants.hpp.
const char* broken_invariant(const heli::FlightCode& code, std::int32_t duty_full) {
  using heli::proofs::holds;
  const heli::Core& core = code.core;
  if (!holds(core.link_.parser_)) return "parser";
  if (!holds(core.link_.dispatcher_, core.link_.mailbox_)) return "exchange";
  if (!holds(core.supervisor_)) return "supervisor";
  if (!holds(core.uploaded_.tape_)) return "upload";
  if (!heli::proofs::holds_verified(core.uploaded_.tape_)) return "interpreter";
  if (!heli::proofs::holds_accepted(core.uploaded_.tape_)) return "verifier";
  // Parameters and what is derived from them are in two banks, of which one is active.
  const auto bank = core.active_.load(std::memory_order_relaxed);
  const bool bounded =
      holds(core.derived_[bank].setpoint_limits) && holds(core.supervisor_.setpoints_);
  if (!bounded) return "setpoints";
  if (!holds(code.cascade.constants_[bank].mixer)) return "mixer";
  const heli::Conversion& conversion = core.derived_[bank].conversion;
  const bool within = holds(conversion.front, duty_full) && holds(conversion.back, duty_full);
  return within ? nullptr : "duty";
}

}  // namespace heli_sim
