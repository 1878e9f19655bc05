// Handles valid frames from the host: commands, streams, the session, exactly-once.
#pragma once

#include <cstddef>
#include <cstdint>

#include "board.hpp"
#include "law/tape.hpp"
#include "link/controller_names.hpp"
#include "link/declaration.hpp"
#include "link/mailbox.hpp"
#include "link/parser.hpp"
#include "link/spsc.hpp"
#include "params/params.hpp"
#include "params/store.hpp"

namespace heli::link {

// One streamed value; `id` says which member counts.
struct StreamValue {
  MessageId id = MessageId::setpoint;
  SetpointMessage setpoint;
  VoltagesMessage voltages;
  FollowingMessage following;
};

using StreamQueue = Spsc<StreamValue, 4>;

// An answer that waits for room in the transmitter.
struct Outgoing {
  static constexpr std::uint8_t kMaxParams = 32;
  static constexpr std::size_t kMaxBytes = ParamsMessage::kSize + 4 * kMaxParams;

  MessageId id = MessageId::ack;
  std::size_t size = 0;
  std::uint8_t payload[kMaxBytes] = {};
};

struct CommandInfo;

// Idle loop only. A command that changes something goes through the mailbox to the tick; at most
// one is on its way. A command that arrives before the last one's answer has left is not answered:
// the host, which sends one at a time, repeats it. Only a stop is never passed over.
class Dispatcher {
 public:
  Dispatcher(Board& board, const params::Params& params, params::Store& store, law::Tape& tape,
             const ControllerNames& controllers, Mailbox& mailbox, StreamQueue& streams)
      : board_(board),
        params_(params),
        store_(store),
        tape_(tape),
        controllers_(controllers),
        mailbox_(mailbox),
        streams_(streams) {}

  // False for a frame that no host sends: on a looped-back line the board receives its own frames.
  bool handle(const Frame& frame, std::uint32_t tick);

  // Turns the tick's reply, when it has come, into an ack; writes the flash for params_save.
  // True when parameters may have changed.
  bool collect(std::uint32_t tick);

  // The answer to send, until sent(). Those with a device time or counters carry zeros there:
  // the sender fills them in at the last moment.
  const Outgoing* reply() const { return reply_waits_ ? &reply_ : nullptr; }
  void sent() { reply_waits_ = false; }

  // Events of this class: parameters saved, streamed values refused.
  Spsc<EventMessage, 4>& events() { return events_; }

  // True after a hello whose declaration matches; only then does the board speak unasked.
  bool session_open() const { return session_open_; }

  std::uint32_t duplicates() const { return duplicates_; }
  std::uint32_t stale_streams() const { return stale_streams_; }

 private:
  // The last command that the tick executed, and its answer: a repeated request gets the same
  // answer and is not executed again.
  struct LastCommand {
    bool valid = false;
    std::uint8_t age = 0;  // other requests seen since
    Request request;
    AckMessage ack;
  };

  void command(const CommandInfo* info, const Frame& frame);
  void local(const Frame& frame);
  void stream(const CommandInfo& info, const Frame& frame, std::uint32_t tick);
  void pass_stream();

  // exchange.cpp: commands that the tick executes, and the memory of the last one.
  void remote(MessageId id, const std::uint8_t* payload, std::uint8_t size);
  void age_requests(std::uint8_t request);

  // answers.cpp: each makes exactly one answer.
  void refuse(const Frame& frame, Result result, std::uint8_t detail = 0);
  void acknowledge(const AckMessage& ack);
  void hello(const Frame& frame);
  void ping(const Frame& frame);
  void params_read(const Frame& frame);
  void report(const Frame& frame, const law::UploadCheck& check);
  void law_read(const Frame& frame);
  void controller_read(const Frame& frame);
  void params_origin_read(const Frame& frame);
  void status_read(const Frame& frame);
  template <class Message>
  void send(const Message& message);

  Board& board_;
  const params::Params& params_;
  params::Store& store_;
  law::Tape& tape_;
  const ControllerNames& controllers_;
  Mailbox& mailbox_;
  StreamQueue& streams_;

  bool session_open_ = false;
  bool session_known_ = false;
  std::uint32_t session_ = 0;

  bool busy_ = false;  // `pending_` is with the tick
  Request pending_;
  bool stop_waits_ = false;  // came while busy; goes to the tick next
  std::uint8_t stop_request_ = 0;
  LastCommand last_command_;
  std::uint8_t last_request_ = 0;

  bool reply_waits_ = false;
  Outgoing reply_;

  bool stream_waits_ = false;
  StreamValue newest_stream_;

  Spsc<EventMessage, 4> events_;
  std::uint32_t duplicates_ = 0;
  std::uint32_t stale_streams_ = 0;
};

}  // namespace heli::link
