// Each answer of the dispatcher, from any state of it: step_X proves that the message X gets one
// answer of its kind and length.
#include "any.hpp"
#include "link/answers.cpp"
#include "no_interrupt.hpp"

using heli::link::Dispatcher;
using heli::link::Frame;
using heli::link::MessageId;
using heli::link::Outgoing;
using heli::proofs::any;

// Contracts: none of these touches the dispatcher.
heli::BootReport heli::Board::boot_report() { return any<BootReport>(); }
void heli::params::Params::defaults() {}

namespace {

heli::Board board;
heli::link::ControllerNames names;
heli::link::Mailbox mailbox;
heli::link::StreamQueue streams;
heli::params::Params params;
heli::params::Store store(board);
heli::law::Tape tape;
// Whoever dispatches has checked that a command is as long as declared: no further byte is read.
constexpr std::size_t kMostBytes = heli::link::LawPartMessage::kSize;
std::uint8_t payload[kMostBytes];
char name[heli::link::ControllerNames::kCharacters + 1];

// Any state without a waiting reply, and any payload.
void put_in_any_state(Dispatcher& d) {
  for (std::uint8_t& byte : payload) {
    byte = any<std::uint8_t>();
  }
  tape.stored_.value_ = any<heli::link::LawState>();
  tape.flying_.value_ = any<bool>();
  d.session_open_ = any<bool>();
  d.session_known_ = any<bool>();
  d.session_ = any<std::uint32_t>();
  d.last_command_.valid = any<bool>();
  d.reply_.id = any<MessageId>();
  d.reply_.size = any<std::size_t>();
  d.reply_waits_ = false;
}

// A frame of this id and size with any payload.
Frame frame_of(MessageId id, std::size_t size) {
  Frame frame;
  frame.id = static_cast<std::uint8_t>(id);
  frame.size = static_cast<std::uint8_t>(size);
  // At the end of the array, so that a byte behind the message is out of bounds.
  frame.payload = payload + (kMostBytes - size);
  return frame;
}

// The dispatcher has made one answer to `frame`: of this id and size.
void check_answer(const Dispatcher& d, const Frame& frame, MessageId id, std::size_t size) {
  CLAIM(d.reply_waits_, "there is an answer");
  CLAIM(d.reply_.id == id, "it is of its kind");
  CLAIM(d.reply_.size == size, "it is as long as declared");
  CLAIM(d.reply_.size <= Outgoing::kMaxBytes, "it fits");
  CLAIM(d.reply_.payload[0] == frame.payload[0], "it has the number of its request");
}

// The dispatcher `d` of a proof.
#define PREPARE() Dispatcher d(board, params, store, tape, names, mailbox, streams)

}  // namespace

void step_refuse() {
  PREPARE();
  put_in_any_state(d);
  Frame frame = frame_of(any<MessageId>(), 1);
  d.refuse(frame, any<heli::link::Result>(), any<std::uint8_t>());
  check_answer(d, frame, MessageId::ack, heli::link::AckMessage::kSize);
  CLAIM(d.reply_.payload[1] == frame.id, "it names the message");
}

// A message without payload has no request number: the answer has 0.
void step_refuse_without_content() {
  PREPARE();
  put_in_any_state(d);
  const std::uint8_t zero = 0;
  Frame frame = frame_of(any<MessageId>(), 0);
  d.refuse(frame, any<heli::link::Result>(), any<std::uint8_t>());
  frame.payload = &zero;
  check_answer(d, frame, MessageId::ack, heli::link::AckMessage::kSize);
}

void step_acknowledge() {
  PREPARE();
  put_in_any_state(d);
  heli::link::AckMessage ack;
  const Frame frame = frame_of(MessageId::stop, 1);
  ack.request = frame.payload[0];
  d.acknowledge(ack);
  check_answer(d, frame, MessageId::ack, heli::link::AckMessage::kSize);
}

void step_hello() {
  PREPARE();
  put_in_any_state(d);
  const Frame frame = frame_of(MessageId::hello, heli::link::HelloMessage::kSize);
  d.hello(frame);
  check_answer(d, frame, MessageId::welcome, heli::link::WelcomeMessage::kSize);
  CLAIM(d.session_open_ ==
            (heli::link::HelloMessage::read(frame.payload).link_hash == heli::link::kLinkHash),
        "only the same declaration opens a session");
}

void step_ping() {
  PREPARE();
  put_in_any_state(d);
  const Frame frame = frame_of(MessageId::ping, heli::link::PingMessage::kSize);
  d.ping(frame);
  check_answer(d, frame, MessageId::pong, heli::link::PongMessage::kSize);
}

void step_status_read() {
  PREPARE();
  put_in_any_state(d);
  const Frame frame = frame_of(MessageId::status_read, heli::link::StatusReadMessage::kSize);
  d.status_read(frame);
  check_answer(d, frame, MessageId::status, heli::link::StatusMessage::kSize);
}

void step_report() {
  PREPARE();
  put_in_any_state(d);
  const Frame frame = frame_of(MessageId::law_begin, heli::link::LawBeginMessage::kSize);
  d.report(frame, {any<heli::law::LawError>(), any<std::uint32_t>()});
  check_answer(d, frame, MessageId::ack, heli::link::AckMessage::kSize);
}

void step_law_read() {
  PREPARE();
  put_in_any_state(d);
  const Frame frame = frame_of(MessageId::law_read, heli::link::LawReadMessage::kSize);
  d.law_read(frame);
  check_answer(d, frame, MessageId::law, heli::link::LawMessage::kSize);
}

// Names of controllers of any length, up to the longest.
void step_controller_read() {
  PREPARE();
  put_in_any_state(d);
  names.count = any<std::size_t>();
  ASSUME(names.count <= heli::link::ControllerNames::kMax);
  for (char& character : name) {
    character = any<char>();
  }
  name[heli::link::ControllerNames::kCharacters] = '\0';
  for (const char*& each : names.name) {
    each = name;
  }
  const Frame frame =
      frame_of(MessageId::controller_read, heli::link::ControllerReadMessage::kSize);
  d.controller_read(frame);
  check_answer(d, frame, MessageId::controller, heli::link::ControllerMessage::kSize);
}

void step_params_origin_read() {
  PREPARE();
  put_in_any_state(d);
  const Frame frame =
      frame_of(MessageId::params_origin_read, heli::link::ParamsOriginReadMessage::kSize);
  d.params_origin_read(frame);
  check_answer(d, frame, MessageId::params_origin, heli::link::ParamsOriginMessage::kSize);
}

// As many parameters as fit, from the requested first one on; a first one that does not exist is
// refused.
void step_params_read() {
  PREPARE();
  put_in_any_state(d);
  const Frame frame = frame_of(MessageId::params_read, heli::link::ParamsReadMessage::kSize);
  const auto first = heli::link::ParamsReadMessage::read(frame.payload).first;
  d.params_read(frame);
  if (first >= heli::link::kParamCount) {
    check_answer(d, frame, MessageId::ack, heli::link::AckMessage::kSize);
    return;
  }
  const std::size_t rest = heli::link::kParamCount - first;
  const std::size_t count = rest < Outgoing::kMaxParams ? rest : Outgoing::kMaxParams;
  check_answer(d, frame, MessageId::params, heli::link::ParamsMessage::kSize + 4 * count);
}
