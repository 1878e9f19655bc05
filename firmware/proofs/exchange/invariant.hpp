// What the proofs of the exchange assume before a call and prove after it.
#pragma once

#include "link/dispatch.hpp"

namespace heli::proofs {

// A request is with the tick exactly while the dispatcher is busy; a stop waits only for that.
inline bool holds(const link::Dispatcher& dispatcher, const link::Mailbox& mailbox) {
  return dispatcher.busy_ == (value_of(mailbox.state_) != link::Mailbox::Slot::empty) &&
         (!dispatcher.stop_waits_ || dispatcher.busy_) &&
         dispatcher.reply_.size <= link::Outgoing::kMaxBytes &&
         dispatcher.pending_.size <= link::Request::kMaxBytes &&
         dispatcher.last_command_.request.size <= link::Request::kMaxBytes;
}

}  // namespace heli::proofs
