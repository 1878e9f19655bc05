#include "link/dispatch.hpp"

#include <cstring>

#include "link/bytes.hpp"

namespace heli::link {

enum class Kind : std::uint8_t {
  local,   // answered here
  remote,  // executed by the tick
  stream,  // passed to the tick, not answered
};

struct CommandInfo {
  MessageId id;
  Kind kind;
  std::uint8_t size;
  // The message's floats: they follow each other in every message.
  std::uint8_t float_offset;
  std::uint8_t float_field;  // position of the first among the message's fields
  std::uint8_t float_count;
};

namespace {

template <class Message>
constexpr CommandInfo entry(Kind kind, std::uint8_t offset = 0, std::uint8_t field = 0,
                            std::uint8_t floats = 0) {
  return {Message::kId, kind, static_cast<std::uint8_t>(Message::kSize), offset, field, floats};
}

constexpr CommandInfo kCommands[] = {
    entry<HelloMessage>(Kind::local),
    entry<PingMessage>(Kind::local),
    entry<ArmMessage>(Kind::remote),
    entry<StopMessage>(Kind::remote),
    entry<ControlMessage>(Kind::remote, 2, 2, 2),
    entry<StreamMessage>(Kind::remote),
    entry<LandMessage>(Kind::remote),
    entry<ExciteMessage>(Kind::remote, 2, 2, 5),
    entry<ExciteStopMessage>(Kind::remote),
    entry<ParamSetMessage>(Kind::remote, 2, 2, 1),
    entry<ParamsReadMessage>(Kind::local),
    entry<ParamsSaveMessage>(Kind::remote),
    entry<ParamsDefaultMessage>(Kind::remote),
    entry<ZeroMessage>(Kind::remote),
    entry<ClearFaultMessage>(Kind::remote),
    entry<StatusReadMessage>(Kind::local),
    entry<LawBeginMessage>(Kind::local),
    entry<LawPartMessage>(Kind::local),
    entry<LawEndMessage>(Kind::local),
    entry<LawFlyMessage>(Kind::remote),
    entry<LawSetMessage>(Kind::remote, 2, 2, 1),
    entry<LawReadMessage>(Kind::local),
    entry<ControllerReadMessage>(Kind::local),
    entry<ParamsOriginReadMessage>(Kind::local),
    entry<SetpointMessage>(Kind::stream, 4, 1, 3),
    entry<VoltagesMessage>(Kind::stream, 0, 0, 2),
    entry<FollowingMessage>(Kind::stream, 0, 0, 3),
};

// Ids from here on travel from the board to the host.
constexpr std::uint8_t kFirstReplyId = 128;

constexpr std::uint8_t kNoField = 0xff;

// A request number is remembered for this many others: far more than a retry can lag behind, and
// so few that the number of a new command, eight bits and counting, cannot meet an old one.
constexpr std::uint8_t kMemoryAge = 128;

const CommandInfo* find(std::uint8_t id) {
  for (const CommandInfo& info : kCommands) {
    if (static_cast<std::uint8_t>(info.id) == id) return &info;
  }
  return nullptr;
}

// The first field that is NaN or infinite, kNoField if all are numbers.
std::uint8_t bad_float(const CommandInfo& info, const std::uint8_t* payload) {
  constexpr std::uint32_t kExponent = 0x7f800000U;
  for (std::uint8_t i = 0; i < info.float_count; ++i) {
    if ((get_u32(payload + info.float_offset + 4 * i) & kExponent) == kExponent) {
      return static_cast<std::uint8_t>(info.float_field + i);
    }
  }
  return kNoField;
}

bool same(const Request& a, const Request& b) {
  return a.id == b.id && a.size == b.size && std::memcmp(a.payload, b.payload, a.size) == 0;
}

}  // namespace

bool Dispatcher::handle(const Frame& frame, std::uint32_t tick) {
  // To answer what it said itself the board would never end.
  if (frame.id >= kFirstReplyId) return false;
  const CommandInfo* info = find(frame.id);
  if (info == nullptr || info->kind != Kind::stream) {
    command(info, frame);
  } else if (session_open_) {
    stream(*info, frame, tick);
  }
  return true;
}

void Dispatcher::command(const CommandInfo* info, const Frame& frame) {
  const bool is_stop = info != nullptr && info->id == MessageId::stop;
  if (busy_ && is_stop && session_open_ && frame.size == info->size) {
    stop_waits_ = true;
    stop_request_ = frame.payload[0];
  }
  // A stop takes the place of an answer that cannot leave: whoever stops has given up on that one.
  if (busy_ || (reply_waits_ && !is_stop)) return;
  if (frame.size > 0) age_requests(frame.payload[0]);

  const bool is_hello = info != nullptr && info->id == MessageId::hello;
  if (!is_hello && !session_open_) return refuse(frame, Result::no_handshake);
  if (info == nullptr) return refuse(frame, Result::unknown_command);
  if (frame.size != info->size) return refuse(frame, Result::bad_length);
  const std::uint8_t field = bad_float(*info, frame.payload);
  if (field != kNoField) return refuse(frame, Result::bad_value, field);
  if (info->kind == Kind::local) return local(frame);
  remote(info->id, frame.payload, frame.size);
}

void Dispatcher::local(const Frame& frame) {
  switch (static_cast<MessageId>(frame.id)) {
    case MessageId::hello:
      return hello(frame);
    case MessageId::ping: {
      PongMessage pong;
      pong.request = frame.payload[0];
      pong.host_us = PingMessage::read(frame.payload).host_us;
      return send(pong);
    }
    case MessageId::params_read:
      return params_read(frame);
    // Whichever of these comes twice does the same twice, so none needs the memory of commands.
    case MessageId::law_begin:
      return report(frame, tape_.begin(LawBeginMessage::read(frame.payload)));
    case MessageId::law_part:
      return report(frame, tape_.receive(LawPartMessage::read(frame.payload)));
    case MessageId::law_end:
      return report(frame, tape_.end());
    case MessageId::law_read:
      return law_read(frame);
    case MessageId::controller_read:
      return controller_read(frame);
    case MessageId::params_origin_read:
      return params_origin_read(frame);
    default: {
      StatusMessage status;
      status.request = frame.payload[0];
      return send(status);
    }
  }
}

void Dispatcher::hello(const Frame& frame) {
  const auto message = HelloMessage::read(frame.payload);
  session_open_ = message.link_hash == kLinkHash;
  if (session_open_) {
    if (!session_known_ || session_ != message.session) memory_.valid = false;
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
  for (std::size_t i = 0; i < head.count; ++i, reply_.size += 4) {
    put_f32(reply_.payload + reply_.size, params_.data()[message.first + i]);
  }
}

void Dispatcher::report(const Frame& frame, const law::UploadCheck& finding) {
  AckMessage ack;
  ack.request = frame.payload[0];
  ack.command = frame.id;
  ack.result =
      static_cast<std::uint8_t>(finding.error == LawError::none ? Result::ok : Result::bad_law);
  ack.detail = static_cast<std::uint8_t>(finding.error);
  ack.value = static_cast<float>(finding.value);
  send(ack);
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

void Dispatcher::remote(MessageId id, const std::uint8_t* payload, std::uint8_t size) {
  pending_.id = id;
  pending_.size = size;
  std::memcpy(pending_.payload, payload, size);
  if (memory_.valid && same(memory_.request, pending_)) {
    ++duplicates_;
    return send(memory_.ack);
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
  send(memory_.ack);
  if (stop_waits_) {
    stop_waits_ = false;
    age_requests(stop_request_);
    remote(MessageId::stop, &stop_request_, StopMessage::kSize);
  }
  return true;
}

void Dispatcher::stream(const CommandInfo& info, const Frame& frame, std::uint32_t tick) {
  Result result = Result::ok;
  std::uint8_t field = kNoField;
  if (frame.size != info.size) {
    result = Result::bad_length;
  } else {
    field = bad_float(info, frame.payload);
    if (field != kNoField) result = Result::bad_value;
  }
  if (result != Result::ok) {
    ++stale_streams_;
    EventMessage rejected;
    rejected.tick = tick;
    rejected.kind = static_cast<std::uint8_t>(Event::setpoint_rejected);
    rejected.detail = static_cast<std::uint8_t>(result);
    events_.push(rejected);
    return;
  }
  pass_stream();
  newest_stream_.id = info.id;
  if (info.id == MessageId::setpoint) {
    newest_stream_.setpoint = SetpointMessage::read(frame.payload);
  } else if (info.id == MessageId::voltages) {
    newest_stream_.voltages = VoltagesMessage::read(frame.payload);
  } else {
    newest_stream_.following = FollowingMessage::read(frame.payload);
  }
  stream_waits_ = true;
  pass_stream();
}

void Dispatcher::pass_stream() {
  // While the queue is full the newest value stays here, where a newer one may replace it.
  if (stream_waits_ && streams_.push(newest_stream_)) stream_waits_ = false;
}

void Dispatcher::age_requests(std::uint8_t request) {
  if (request == last_request_) return;
  last_request_ = request;
  if (memory_.valid && ++memory_.age >= kMemoryAge) memory_.valid = false;
}

void Dispatcher::refuse(const Frame& frame, Result result, std::uint8_t detail) {
  AckMessage ack;
  ack.request = frame.size > 0 ? frame.payload[0] : std::uint8_t{0};
  ack.command = frame.id;
  ack.result = static_cast<std::uint8_t>(result);
  ack.detail = detail;
  send(ack);
}

template <class Message>
void Dispatcher::send(const Message& message) {
  static_assert(Message::kSize <= Outgoing::kMaxBytes, "the reply must fit");
  reply_.id = Message::kId;
  reply_.size = Message::kSize;
  message.write(reply_.payload);
  reply_waits_ = true;
}

}  // namespace heli::link
