// One request at a time from the idle loop to the control tick, and its reply back.
#pragma once

#include <atomic>
#include <cstddef>
#include <cstdint>

#include "link/declaration.hpp"

namespace heli::link {

// A command whose length and floats have been checked. Enumerations, masks and ranges have not:
// which values are allowed depends on the state, which only the tick knows.
struct Request {
  static constexpr std::size_t kMaxBytes = ExciteMessage::kSize;

  MessageId id = MessageId::stop;
  std::uint8_t size = 0;
  std::uint8_t payload[kMaxBytes] = {};

  // The decoded message: request.as<ControlMessage>().front_V.
  template <class Message>
  Message as() const {
    static_assert(Message::kSize <= kMaxBytes, "no command is this long");
    return Message::read(payload);
  }
};

// The tick's result of a request; copied into the ack unchanged.
struct Reply {
  Result result = Result::ok;
  std::uint8_t detail = 0;
  float value = 0.0F;
};

class Mailbox {
 public:
  // Idle loop: hands a request over. False while one is still on its way.
  bool post(const Request& request) {
    if (state_.load(std::memory_order_relaxed) != Slot::empty) return false;
    request_ = request;
    state_.store(Slot::pending, std::memory_order_release);
    return true;
  }

  // Idle loop: true, once, when the tick has answered.
  bool collect(Reply& reply) {
    if (state_.load(std::memory_order_acquire) != Slot::done) return false;
    reply = reply_;
    state_.store(Slot::empty, std::memory_order_relaxed);
    return true;
  }

  // Tick: the request that waits, the same one until it is answered; null when there is none.
  const Request* take() const {
    return state_.load(std::memory_order_acquire) == Slot::pending ? &request_ : nullptr;
  }

  // Tick: the answer to what take() gave.
  void answer(const Reply& reply) {
    reply_ = reply;
    state_.store(Slot::done, std::memory_order_release);
  }

 private:
  enum class Slot : std::uint8_t { empty, pending, done };

  std::atomic<Slot> state_{Slot::empty};
  Request request_;
  Reply reply_;
};

}  // namespace heli::link
