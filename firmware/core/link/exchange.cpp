// Gives one command at a time to the tick and takes its reply, so that each command is executed
// exactly once, although the host repeats requests. Idle loop.
#include <cstring>

#include "link/dispatch.hpp"

namespace heli::link {

namespace {

// A request number is remembered for this many others: far more than a retry can lag behind, and
// so few that the number of a new command, eight bits and counting, cannot meet an old one.
constexpr std::uint8_t kForgetAfterRequests = 128;

bool same_command(const Request& a, const Request& b) {
  return a.id == b.id && a.size == b.size && std::memcmp(a.payload, b.payload, a.size) == 0;
}

}  // namespace

// Posts a command to the tick, unless it repeats the last one: that is answered from memory.
void Dispatcher::remote(MessageId id, const std::uint8_t* payload, std::uint8_t size) {
  pending_.id = id;
  pending_.size = size;
  std::memcpy(pending_.payload, payload, size);
  if (last_command_.valid && same_command(last_command_.request, pending_)) {
    ++duplicates_;
    return acknowledge(last_command_.ack);
  }
  busy_ = mailbox_.post(pending_);
}

// First retries a streamed value that found the queue full. A stop that waits counts as a request
// seen.
bool Dispatcher::collect(std::uint32_t tick) {
  pass_stream();
  Reply reply;
  if (!mailbox_.collect(reply)) return false;
  if (pending_.id == MessageId::params_save && reply.result == Result::ok) {
    if (store_.save(params_)) {
      EventMessage saved;
      saved.tick = tick;
      saved.kind = static_cast<std::uint8_t>(Event::params_saved);
      saved.value = static_cast<float>(store_.generation());
      events_.push(saved);
      reply.value = saved.value;
    } else {
      reply.result = Result::flash_failed;
    }
  }
  last_command_.valid = true;
  last_command_.age = 0;
  last_command_.request = pending_;
  last_command_.ack.request = pending_.payload[0];
  last_command_.ack.command = static_cast<std::uint8_t>(pending_.id);
  last_command_.ack.result = static_cast<std::uint8_t>(reply.result);
  last_command_.ack.detail = reply.detail;
  last_command_.ack.value = reply.value;
  busy_ = false;
  acknowledge(last_command_.ack);
  // A stop that came while the tick was busy goes next.
  if (stop_waits_) {
    stop_waits_ = false;
    age_requests(stop_request_);
    remote(MessageId::stop, &stop_request_, StopMessage::kSize);
  }
  return true;
}

// Counts the requests with other numbers since the last command; forgets it before its number
// recurs.
void Dispatcher::age_requests(std::uint8_t request) {
  if (request == last_request_) return;
  last_request_ = request;
  if (last_command_.valid && ++last_command_.age >= kForgetAfterRequests)
    last_command_.valid = false;
}

}  // namespace heli::link
