// One command at a time to the tick and back, each exactly once.
#include <cstring>

#include "link/dispatch.hpp"

namespace heli::link {

namespace {

// A request number is remembered for this many others: far more than a retry can lag behind, and
// so few that the number of a new command, eight bits and counting, cannot meet an old one.
constexpr std::uint8_t kMemoryAge = 128;

bool same(const Request& a, const Request& b) {
  return a.id == b.id && a.size == b.size && std::memcmp(a.payload, b.payload, a.size) == 0;
}

}  // namespace

void Dispatcher::remote(MessageId id, const std::uint8_t* payload, std::uint8_t size) {
  pending_.id = id;
  pending_.size = size;
  std::memcpy(pending_.payload, payload, size);
  if (memory_.valid && same(memory_.request, pending_)) {
    ++duplicates_;
    return acknowledge(memory_.ack);
  }
  busy_ = mailbox_.post(pending_);
}

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
  memory_.valid = true;
  memory_.age = 0;
  memory_.request = pending_;
  memory_.ack.request = pending_.payload[0];
  memory_.ack.command = static_cast<std::uint8_t>(pending_.id);
  memory_.ack.result = static_cast<std::uint8_t>(reply.result);
  memory_.ack.detail = reply.detail;
  memory_.ack.value = reply.value;
  busy_ = false;
  acknowledge(memory_.ack);
  if (stop_waits_) {
    stop_waits_ = false;
    age_requests(stop_request_);
    remote(MessageId::stop, &stop_request_, StopMessage::kSize);
  }
  return true;
}

void Dispatcher::age_requests(std::uint8_t request) {
  if (request == last_request_) return;
  last_request_ = request;
  if (memory_.valid && ++memory_.age >= kMemoryAge) memory_.valid = false;
}

}  // namespace heli::link
