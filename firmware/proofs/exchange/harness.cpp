// One command on its way to the tick, and one reply of the tick, from any state of the exchange.
#include <cstring>

#include "any.hpp"
#include "event_queue.hpp"
#include "exchange/invariant.hpp"

// Contracts: two commands are the same or not; a copy fits, and no claim says which bytes it has.
namespace std {
inline int any_memcmp(const void*, const void*, std::size_t) { return heli::proofs::any<int>(); }
inline void any_copy(std::uint8_t*, const std::uint8_t*, std::size_t count) {
  CLAIM(count <= heli::link::Request::kMaxBytes, "a command fits");
}
}  // namespace std
#define memcmp any_memcmp
#define memcpy any_copy
#include "link/exchange.cpp"
#undef memcmp
#undef memcpy
#include "no_interrupt.hpp"

using heli::link::Dispatcher;
using heli::link::Mailbox;
using heli::link::MessageId;
using heli::link::Request;
using heli::proofs::any;
using heli::proofs::holds;

namespace {

int answers;

}  // namespace

// Contracts: an acknowledgement is one answer; streams and saves do not touch the exchange.
void heli::link::Dispatcher::acknowledge(const AckMessage&) {
  ++answers;
  reply_waits_ = true;
}
void heli::link::Dispatcher::pass_stream() { stream_waits_ = any<bool>(); }
void heli::params::Params::defaults() {}
bool heli::params::Store::save(const Params&) { return any<bool>(); }

namespace {

heli::Board board;
heli::link::ControllerNames names;
heli::params::Params params;
heli::params::Store store(board);
heli::law::Tape tape;
Mailbox mailbox;
heli::link::StreamQueue streams;
std::uint8_t payload[Request::kMaxBytes];

// Any state of dispatcher and mailbox that satisfies the invariant.
void put_in_any_state(Dispatcher& d) {
  mailbox.state_.value_ = any<Mailbox::Slot>();
  mailbox.reply_.result = any<heli::link::Result>();
  d.busy_ = any<bool>();
  d.pending_.id = any<MessageId>();
  d.pending_.size = any<std::uint8_t>();
  d.stop_waits_ = any<bool>();
  d.stop_request_ = any<std::uint8_t>();
  d.last_command_.valid = any<bool>();
  d.last_command_.age = any<std::uint8_t>();
  d.last_command_.request.id = any<MessageId>();
  d.last_command_.request.size = any<std::uint8_t>();
  d.last_request_ = any<std::uint8_t>();
  d.reply_waits_ = any<bool>();
  ASSUME(holds(d, mailbox));
}

}  // namespace

// A command for the tick, while none is with it.
void step_remote() {
  Dispatcher d(board, params, store, tape, names, mailbox, streams);
  put_in_any_state(d);
  ASSUME(!d.busy_);
  const auto id = any<MessageId>();
  const auto size = any<std::uint8_t>();
  ASSUME(size <= Request::kMaxBytes);

  d.remote(id, payload, size);

  CLAIM(holds(d, mailbox), "the invariant is kept");
  CLAIM(answers + (d.busy_ ? 1 : 0) == 1, "a command goes to the tick or is answered");
  CLAIM(!d.busy_ ||
            (mailbox.state_.value_ == Mailbox::Slot::pending &&
             static_cast<std::uint8_t>(mailbox.request_.id) == static_cast<std::uint8_t>(id) &&
             mailbox.request_.size == size),
        "the tick gets this command");
}

// The idle loop looks for the tick's reply.
void step_reply() {
  Dispatcher d(board, params, store, tape, names, mailbox, streams);
  put_in_any_state(d);
  const bool has_answered = mailbox.state_.value_ == Mailbox::Slot::done;
  const bool stop_waited = d.stop_waits_;
  const bool was_busy = d.busy_;

  d.collect(any<std::uint32_t>());

  CLAIM(holds(d, mailbox), "the invariant is kept");
  if (!has_answered) {
    CLAIM(answers == 0 && d.busy_ == was_busy, "there is no answer before the tick's");
    return;
  }
  CLAIM(!d.stop_waits_, "a stop waits for one command at most");
  // The tick's answer; a stop that waited goes to the tick, or is the one that it has just made.
  const bool is_repeated = stop_waited && !d.busy_;
  CLAIM(answers == (is_repeated ? 2 : 1), "each reply of the tick is one answer");
  CLAIM(stop_waited || !d.busy_, "only a stop follows by itself");
  CLAIM(!d.busy_ || (mailbox.request_.id == MessageId::stop &&
                     mailbox.request_.size == heli::link::StopMessage::kSize),
        "nothing but a stop follows");
}
