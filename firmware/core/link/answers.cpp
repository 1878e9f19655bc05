// Answers of the idle loop itself, and their storage until there is room to send them.
#include "link/bytes.hpp"
#include "link/dispatch.hpp"

namespace heli::link {

// Stores the answer; Link sends it when the transmitter has room.
template <class Message>
void Dispatcher::send(const Message& message) {
  static_assert(Message::kSize <= Outgoing::kMaxBytes, "the reply must fit");
  reply_.id = Message::kId;
  reply_.size = Message::kSize;
  message.write(reply_.payload);
  reply_waits_ = true;
}

void Dispatcher::acknowledge(const AckMessage& ack) { send(ack); }

void Dispatcher::refuse(const Frame& frame, Result result, std::uint8_t detail) {
  AckMessage ack;
  ack.request = frame.size > 0 ? frame.payload[0] : std::uint8_t{0};
  ack.command = frame.id;
  ack.result = static_cast<std::uint8_t>(result);
  ack.detail = detail;
  acknowledge(ack);
}

void Dispatcher::ping(const Frame& frame) {
  PongMessage pong;
  pong.request = frame.payload[0];
  pong.host_us = PingMessage::read(frame.payload).host_us;
  send(pong);
}

void Dispatcher::status_read(const Frame& frame) {
  StatusMessage status;
  status.request = frame.payload[0];
  send(status);
}

// Opens a session if the host has the same declaration. A new session forgets the last command.
void Dispatcher::hello(const Frame& frame) {
  const auto message = HelloMessage::read(frame.payload);
  session_open_ = message.link_hash == kLinkHash;
  if (session_open_) {
    if (!session_known_ || session_ != message.session) last_command_.valid = false;
    session_known_ = true;
    session_ = message.session;
  }
  const BootReport boot = board_.boot_report();
  WelcomeMessage welcome;
  welcome.request = message.request;
  welcome.result = static_cast<std::uint8_t>(session_open_ ? Result::ok : Result::hash_mismatch);
  welcome.link_hash = kLinkHash;
  welcome.link_major = kLinkMajor;
  welcome.link_minor = kLinkMinor;
  welcome.firmware_major = kFirmwareMajor;
  welcome.firmware_minor = kFirmwareMinor;
  welcome.firmware_patch = kFirmwarePatch;
  welcome.board = boot.board;
  welcome.reset = boot.reset;
  welcome.boot_fault = boot.boot_fault;
  welcome.boot_id = boot.boot_id;
  welcome.params_source = static_cast<std::uint8_t>(store_.source());
  send(welcome);
}

// Answers with the values from `first` on, as many as fit one message.
void Dispatcher::params_read(const Frame& frame) {
  const auto message = ParamsReadMessage::read(frame.payload);
  if (message.first >= kParamCount) {
    return refuse(frame, Result::no_such_parameter, message.first);
  }
  const std::size_t rest = kParamCount - message.first;
  ParamsMessage head;
  head.request = message.request;
  head.first = message.first;
  head.count = rest < Outgoing::kMaxParams ? static_cast<std::uint8_t>(rest) : Outgoing::kMaxParams;
  send(head);
  std::uint8_t* values = reply_.payload + ParamsMessage::kSize;
  for (std::size_t i = 0; i < head.count; ++i) {
    put_f32(values + 4 * i, params_.data()[message.first + i]);
  }
  reply_.size += 4U * head.count;
}

// Acknowledges a step of a law's upload with the result of its check.
void Dispatcher::report(const Frame& frame, const law::UploadCheck& check) {
  AckMessage ack;
  ack.request = frame.payload[0];
  ack.command = frame.id;
  ack.result =
      static_cast<std::uint8_t>(check.error == LawError::none ? Result::ok : Result::bad_law);
  ack.detail = static_cast<std::uint8_t>(check.error);
  ack.value = static_cast<float>(check.value);
  acknowledge(ack);
}

void Dispatcher::law_read(const Frame& frame) {
  LawMessage law;
  law.request = frame.payload[0];
  law.hash = tape_.hash();
  law.state = static_cast<std::uint8_t>(tape_.state());
  if (tape_.state() == LawState::ready || tape_.state() == LawState::flying) {
    law.divisor = static_cast<std::uint8_t>(tape_.shape().divisor);
    law.ticks = static_cast<std::uint8_t>(tape_.ticks());
    law.cost = tape_.cost();
  }
  send(law);
}

void Dispatcher::controller_read(const Frame& frame) {
  const auto message = ControllerReadMessage::read(frame.payload);
  std::uint8_t characters[ControllerNames::kCharacters] = {};
  if (message.index < controllers_.count) {
    const char* name = controllers_.name[message.index];
    for (std::size_t i = 0; i < sizeof characters && name[i] != '\0'; ++i) {
      characters[i] = static_cast<std::uint8_t>(name[i]);
    }
  }
  ControllerMessage reply;
  reply.request = message.request;
  reply.index = message.index;
  reply.count = static_cast<std::uint8_t>(controllers_.count);
  reply.name_0 = get_u32(characters);
  reply.name_1 = get_u32(characters + 4);
  reply.name_2 = get_u32(characters + 8);
  reply.name_3 = get_u32(characters + 12);
  send(reply);
}

void Dispatcher::params_origin_read(const Frame& frame) {
  const params::Origin& origin = store_.origin();
  ParamsOriginMessage reply;
  reply.request = frame.payload[0];
  reply.source = static_cast<std::uint8_t>(store_.source());
  reply.schema = origin.schema;
  reply.kept = origin.kept;
  reply.dropped = origin.dropped;
  reply.new_0 = origin.fresh[0];
  reply.new_1 = origin.fresh[1];
  reply.new_2 = origin.fresh[2];
  send(reply);
}

}  // namespace heli::link
