// The table of commands and the checks that all of them share; see dispatch.hpp. Idle loop.
#include "link/dispatch.hpp"

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
  Floats floats;
};

namespace {

template <class Message>
constexpr CommandInfo entry(Kind kind) {
  return {Message::kId, kind, static_cast<std::uint8_t>(Message::kSize), Message::kFloats};
}

constexpr CommandInfo kCommands[] = {
    entry<HelloMessage>(Kind::local),          entry<PingMessage>(Kind::local),
    entry<ArmMessage>(Kind::remote),           entry<StopMessage>(Kind::remote),
    entry<ControlMessage>(Kind::remote),       entry<StreamMessage>(Kind::remote),
    entry<LandMessage>(Kind::remote),          entry<ExciteMessage>(Kind::remote),
    entry<ExciteStopMessage>(Kind::remote),    entry<ParamSetMessage>(Kind::remote),
    entry<ParamsReadMessage>(Kind::local),     entry<ParamsSaveMessage>(Kind::remote),
    entry<ParamsDefaultMessage>(Kind::remote), entry<ZeroMessage>(Kind::remote),
    entry<ClearFaultMessage>(Kind::remote),    entry<StatusReadMessage>(Kind::local),
    entry<LawBeginMessage>(Kind::local),       entry<LawPartMessage>(Kind::local),
    entry<LawEndMessage>(Kind::local),         entry<LawFlyMessage>(Kind::remote),
    entry<LawSetMessage>(Kind::remote),        entry<LawReadMessage>(Kind::local),
    entry<ControllerReadMessage>(Kind::local), entry<ParamsOriginReadMessage>(Kind::local),
    entry<SetpointMessage>(Kind::stream),      entry<VoltagesMessage>(Kind::stream),
    entry<FollowingMessage>(Kind::stream),
};

// Ids from here on travel from the board to the host.
constexpr std::uint8_t kFirstReplyId = 128;

constexpr std::uint8_t kNoField = 0xff;

const CommandInfo* find(std::uint8_t id) {
  for (const CommandInfo& info : kCommands) {
    if (static_cast<std::uint8_t>(info.id) == id) return &info;
  }
  return nullptr;
}

// The first field that is NaN or infinite, kNoField if all are numbers.
std::uint8_t bad_float(const CommandInfo& info, const std::uint8_t* payload) {
  constexpr std::uint32_t kExponent = 0x7f800000U;
  for (std::uint8_t i = 0; i < info.floats.count; ++i) {
    if ((get_u32(payload + info.floats.offset + 4 * i) & kExponent) == kExponent) {
      return static_cast<std::uint8_t>(info.floats.field + i);
    }
  }
  return kNoField;
}

}  // namespace

bool Dispatcher::handle(const Frame& frame, std::uint32_t tick) {
  // If the board answered its own frames, it would never stop.
  if (frame.id >= kFirstReplyId) return false;
  const CommandInfo* info = find(frame.id);
  if (info == nullptr || info->kind != Kind::stream) {
    command(info, frame);
  } else if (session_open_) {
    stream(*info, frame, tick);
  }
  return true;
}

// Checks a command, then answers it here or gives it to the tick. Exactly one answer, except when
// the board is busy: then none.
void Dispatcher::command(const CommandInfo* info, const Frame& frame) {
  const bool is_stop = info != nullptr && info->id == MessageId::stop;
  if (busy_ && is_stop && session_open_ && frame.size == info->size) {
    stop_waits_ = true;
    stop_request_ = frame.payload[0];
  }
  // A stop replaces an answer that cannot be sent: a host that stops no longer waits for it.
  if (busy_ || (reply_waits_ && !is_stop)) return;
  if (frame.size > 0) age_requests(frame.payload[0]);

  // The checks that every command must pass.
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
    case MessageId::ping:
      return ping(frame);
    case MessageId::params_read:
      return params_read(frame);
    // Each of these may be executed twice without harm, so none is remembered as a command.
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
    default:
      return status_read(frame);
  }
}

// Checks a streamed value and queues it for the tick. A refused one is counted and becomes an
// event.
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

}  // namespace heli::link
