// The dispatcher: one message of any content, from any state. Each step_* function is one proof.
#include <cfloat>

#include "any.hpp"
#include "event_queue.hpp"

// Contract of the queue from the link to the tick: there is room or not; the last value that was
// stored is remembered.
heli::link::StreamValue passed;
int passed_count;
template <>
bool heli::link::Spsc<heli::link::StreamValue, 4>::push(const StreamValue& value) {
  if (!heli::proofs::any<bool>()) {
    return false;
  }
  passed = value;
  ++passed_count;
  return true;
}
#include "link/dispatch.cpp"
#include "no_interrupt.hpp"

using heli::link::CommandInfo;
using heli::link::Dispatcher;
using heli::link::Frame;
using heli::link::Kind;
using heli::link::MessageId;
using heli::link::StreamValue;
using heli::proofs::any;

namespace {

int answers;  // made by the contracts below, in one call

bool finite(float value) { return value >= -FLT_MAX && value <= FLT_MAX; }

// What the tick may rely on: the message is a command that it executes, has the declared length,
// and its floats are finite.
bool is_fit(MessageId id, const std::uint8_t* bytes, std::size_t size) {
  using heli::link::ControlMessage;
  using heli::link::ExciteMessage;
  using heli::link::LawSetMessage;
  using heli::link::ParamSetMessage;
  switch (id) {
    case MessageId::control: {
      const auto m = ControlMessage::read(bytes);
      return size == ControlMessage::kSize && finite(m.front_V) && finite(m.back_V);
    }
    case MessageId::excite: {
      const auto m = ExciteMessage::read(bytes);
      return size == ExciteMessage::kSize && finite(m.front_V) && finite(m.back_V) &&
             finite(m.start_Hz) && finite(m.stop_Hz) && finite(m.duration_s);
    }
    case MessageId::param_set:
      return size == ParamSetMessage::kSize && finite(ParamSetMessage::read(bytes).value);
    case MessageId::law_set:
      return size == LawSetMessage::kSize && finite(LawSetMessage::read(bytes).value);
    case MessageId::zero:
      return size == heli::link::ZeroMessage::kSize;
    case MessageId::law_fly:
      return size == heli::link::LawFlyMessage::kSize;
    case MessageId::arm:
    case MessageId::stop:
    case MessageId::stream:
    case MessageId::land:
    case MessageId::excite_stop:
    case MessageId::params_save:
    case MessageId::params_default:
    case MessageId::clear_fault:
      return size == heli::link::ArmMessage::kSize;
    default:
      return false;
  }
}

// The same for a streamed value: the floats of its message are finite.
bool is_fit(MessageId id, const heli::link::StreamValue& value) {
  if (value.id != id) {
    return false;
  }
  if (id == MessageId::setpoint) {
    return finite(value.setpoint.elevation_rad) && finite(value.setpoint.pitch_rad) &&
           finite(value.setpoint.travel_rad);
  }
  if (id == MessageId::voltages) {
    return finite(value.voltages.front_V) && finite(value.voltages.back_V);
  }
  return id == MessageId::following && finite(value.following.elevation_rad) &&
         finite(value.following.pitch_rad) && finite(value.following.travel_rad);
}

}  // namespace

namespace heli::link {

// Contracts: the functions of exchange.cpp. A command goes to the tick or is answered from memory.
void Dispatcher::remote(MessageId id, const std::uint8_t* bytes, std::uint8_t size) {
  CLAIM(session_open_ && !busy_, "the tick gets one command at a time, after a handshake");
  CLAIM(is_fit(id, bytes, size), "the tick gets only whole messages and numbers");
  if (any<bool>()) {
    ++answers;
    reply_waits_ = true;
  } else {
    busy_ = true;
  }
}
void Dispatcher::age_requests(std::uint8_t) {
  last_command_.valid = last_command_.valid && any<bool>();
}

// Contracts: the functions of answers.cpp. Each makes one answer.

#define ANSWER() (++answers, reply_waits_ = true)
void Dispatcher::acknowledge(const AckMessage&) { ANSWER(); }
void Dispatcher::refuse(const Frame&, Result, std::uint8_t) { ANSWER(); }
void Dispatcher::hello(const Frame&) {
  ANSWER();
  session_open_ = any<bool>();
  last_command_.valid = last_command_.valid && any<bool>();
}
void Dispatcher::ping(const Frame&) { ANSWER(); }
void Dispatcher::params_read(const Frame&) { ANSWER(); }
void Dispatcher::report(const Frame&, const law::UploadCheck&) { ANSWER(); }
void Dispatcher::law_read(const Frame&) { ANSWER(); }
void Dispatcher::controller_read(const Frame&) { ANSWER(); }
void Dispatcher::params_origin_read(const Frame&) { ANSWER(); }
void Dispatcher::status_read(const Frame&) { ANSWER(); }

}  // namespace heli::link

// Contracts: uploads and saves have any result; they do not touch the dispatcher.
heli::law::UploadCheck heli::law::Tape::begin(const link::LawBeginMessage&) {
  return {any<LawError>(), any<std::uint32_t>()};
}
heli::law::UploadCheck heli::law::Tape::receive(const link::LawPartMessage&) {
  return {any<LawError>(), any<std::uint32_t>()};
}
heli::law::UploadCheck heli::law::Tape::end() { return {any<LawError>(), any<std::uint32_t>()}; }
void heli::params::Params::defaults() {}

namespace {

heli::Board board;
heli::link::ControllerNames names;
heli::params::Params params;
heli::params::Store store(board);
heli::law::Tape tape;
heli::link::Mailbox mailbox;
heli::link::StreamQueue streams;
std::uint8_t payload[heli::link::kMaxCommandPayload];

// Every state that the proofs admit: a stop waits only while a command is with the tick.
void put_in_any_state(Dispatcher& d) {
  d.session_open_ = any<bool>();
  d.busy_ = any<bool>();
  d.stop_waits_ = any<bool>();
  d.stop_request_ = any<std::uint8_t>();
  d.last_command_.valid = any<bool>();
  d.reply_waits_ = any<bool>();
  d.stream_waits_ = any<bool>();
  ASSUME(!d.stop_waits_ || d.busy_);
}

// The payload of the next frame: any bytes.
void put_in_any_payload() {
  for (std::uint8_t& byte : payload) {
    byte = any<std::uint8_t>();
  }
}

// A frame of any length and content.
Frame frame_of(std::uint8_t id) {
  Frame frame;
  frame.id = id;
  frame.size = any<std::uint8_t>();
  frame.payload = payload;
  ASSUME(frame.size <= heli::link::kMaxCommandPayload);
  return frame;
}

// One command, with its row of the table; null for a message that the declaration does not have.
void check_command(const CommandInfo* info, std::uint8_t id) {
  Dispatcher d(board, params, store, tape, names, mailbox, streams);
  put_in_any_state(d);
  const bool was_busy = d.busy_;
  const bool waited = d.reply_waits_;
  const Frame frame = frame_of(id);
  answers = 0;

  d.command(info, frame);

  const bool is_stop = info != nullptr && id == static_cast<std::uint8_t>(MessageId::stop);
  const bool is_first = !was_busy && (!waited || is_stop);
  const bool is_posted = d.busy_ && !was_busy;
  CLAIM(answers + (is_posted ? 1 : 0) == (is_first ? 1 : 0), "each command gets one answer");
  CLAIM(!d.stop_waits_ || was_busy, "a stop waits only behind a command");
}

// One streamed value, with its row of the table.
void check_stream(const CommandInfo& info) {
  Dispatcher d(board, params, store, tape, names, mailbox, streams);
  put_in_any_state(d);
  d.stream_waits_ = false;
  const bool was_busy = d.busy_;
  const bool waited = d.reply_waits_;
  const Frame frame = frame_of(static_cast<std::uint8_t>(info.id));
  answers = 0;
  passed_count = 0;

  d.stream(info, frame, any<std::uint32_t>());

  CLAIM(answers == 0 && d.reply_waits_ == waited && d.busy_ == was_busy, "it has no answer");
  CLAIM(passed_count <= 1, "it is passed once");
  CLAIM(passed_count == 0 || is_fit(info.id, passed), "the tick gets only numbers");
  CLAIM(!d.stream_waits_ || is_fit(info.id, d.newest_stream_), "what waits has only numbers");
  CLAIM((passed_count == 0 && !d.stream_waits_) || frame.size == info.size,
        "the tick gets only whole messages");
}

// A row of the table of commands as constants, so that the solver need not read the table.
template <std::size_t kRow>
CommandInfo row() {
  constexpr const CommandInfo& kInfo = heli::link::kCommands[kRow];
  return {heli::proofs::Folded<MessageId, kInfo.id>::value(),
          heli::proofs::Folded<Kind, kInfo.kind>::value(),
          heli::proofs::Folded<std::uint8_t, kInfo.size>::value(),
          {heli::proofs::Folded<std::uint8_t, kInfo.floats.offset>::value(),
           heli::proofs::Folded<std::uint8_t, kInfo.floats.field>::value(),
           heli::proofs::Folded<std::uint8_t, kInfo.floats.count>::value()}};
}

// Checks the commands of one kind, with or without floats, from row kRow of the table on.
template <std::size_t kRow>
void check_rows(Kind kind, bool has_floats) {
  if constexpr (kRow < sizeof heli::link::kCommands / sizeof heli::link::kCommands[0]) {
    const CommandInfo info = row<kRow>();
    if (info.kind == kind && (info.floats.count > 0) == has_floats) {
      if (kind == Kind::stream) {
        check_stream(info);
      } else {
        check_command(&info, static_cast<std::uint8_t>(info.id));
      }
    }
    check_rows<kRow + 1>(kind, has_floats);
  }
}

// From row kRow on, find() gives each message's own row.
template <std::size_t kRow>
void check_found() {
  if constexpr (kRow < sizeof heli::link::kCommands / sizeof heli::link::kCommands[0]) {
    const auto id = static_cast<std::uint8_t>(row<kRow>().id);
    CLAIM(heli::link::find(id) == &heli::link::kCommands[kRow], "each message has its own row");
    check_found<kRow + 1>();
  }
}

}  // namespace

// The search in the table.
void step_find() {
  check_found<0>();
  const auto id = any<std::uint8_t>();
  const CommandInfo* info = heli::link::find(id);
  CLAIM(info == nullptr || static_cast<std::uint8_t>(info->id) == id, "no message has another's");
}

// A message that the declaration does not have.
void step_unknown() {
  put_in_any_payload();
  check_command(nullptr, any<std::uint8_t>());
}

// Commands that the dispatcher answers itself.
void step_local() {
  put_in_any_payload();
  check_rows<0>(Kind::local, false);
}

// Commands that the tick answers, without floats; then those with floats.
void step_remote() {
  put_in_any_payload();
  check_rows<0>(Kind::remote, false);
}

void step_numbers() {
  put_in_any_payload();
  check_rows<0>(Kind::remote, true);
}

void step_stream() {
  put_in_any_payload();
  check_rows<0>(Kind::stream, true);
}
