// The link's work in the idle loop (receive, answer, pack, send) and its few functions for the
// tick; link.hpp says which is which.
#include "link/link.hpp"

#include <cstring>

namespace heli::link {
namespace {

// Enough to empty any receiver at 25 bytes a millisecond, but bounded.
constexpr std::size_t kReceiveChunk = 64;
constexpr std::size_t kReceiveChunks = 8;

// A batch gives up its place when this many newer samples wait behind it: it could not be sent for
// that many milliseconds, and half of the sample ring is left.
constexpr std::size_t kBatchPatience = 32;

constexpr std::uint32_t kStatusTicks = 1000000U / kTick_us;  // one status per second

}  // namespace

Link::Link(Board& board, params::Params& params, params::Store& store, law::Tape& tape,
           const ControllerNames& controllers)
    : board_(board),
      params_(params),
      dispatcher_(board, params, store, tape, controllers, mailbox_, streams_) {}

void Link::poll() {
  // Parameters change by requests only, and none that changes one is with the tick just after
  // collect() has returned true.
  if (dispatcher_.collect(now()) || batch_ticks_ == 0) read_batch_ticks();
  send_reply();
  receive();
  if (dispatcher_.session_open()) {
    send_events();
  }
  send_telemetry();
  if (dispatcher_.session_open()) send_status();
}

void Link::read_batch_ticks() {
  batch_ticks_ = static_cast<std::size_t>(params_.get(Param::telemetry_batch_ticks));
  if (batch_ticks_ > kMaxBatchTicks) batch_ticks_ = kMaxBatchTicks;
}

// Parses what has arrived, at most kReceiveChunks chunks per call.
void Link::receive() {
  std::uint8_t chunk[kReceiveChunk];
  for (std::size_t i = 0; i < kReceiveChunks; ++i) {
    const std::size_t count = board_.receive(chunk, kReceiveChunk);
    for (std::size_t k = 0; k < count; ++k) {
      if (parser_.put(chunk[k])) accept(parser_.frame());
    }
    if (count < kReceiveChunk) return;
  }
}

void Link::accept(const Frame& frame) {
  const bool from_host = dispatcher_.handle(frame, now());
  if (from_host && dispatcher_.session_open())
    host_frame_tick_.store(now(), std::memory_order_relaxed);
  session_open_.store(dispatcher_.session_open(), std::memory_order_release);
  send_reply();
}

bool Link::take_stream(StreamValue& value) {
  const StreamValue* next = streams_.front();
  if (next == nullptr) return false;
  value = *next;
  streams_.pop();
  return true;
}

Sample& Link::next_sample() {
  Sample* room = samples_.room();
  return room != nullptr ? *room : lost_sample_;
}

void Link::commit_sample(const Sample& sample) {
  if (&sample != &lost_sample_) {
    samples_.keep();
    return;
  }
  samples_lost_.store(samples_lost_.load(std::memory_order_relaxed) + 1, std::memory_order_relaxed);
}

void Link::publish(const TickCounters& counters) {
  constexpr auto kRelaxed = std::memory_order_relaxed;
  overruns_.store(counters.overruns, kRelaxed);
  stale_streams_.store(counters.stale_streams, kRelaxed);
  tick_max_us_.store(counters.tick_max_us, kRelaxed);
  setpoint_rate_Hz_.store(counters.setpoint_rate_Hz, kRelaxed);
  for (std::size_t axis = 0; axis < heli::kAxisCount; ++axis) {
    illegal_[axis].store(counters.illegal[axis], kRelaxed);
  }
}

std::uint32_t Link::ticks_since_host_frame() const {
  if (!session_open_.load(std::memory_order_acquire)) return kNever;
  return now() - host_frame_tick_.load(std::memory_order_relaxed);
}

// Frames and transmits a message. False if the transmitter has no room; then nothing is sent.
bool Link::send(MessageId id, const std::uint8_t* payload, std::size_t size) {
  if (board_.transmit_free() < FrameWriter::wire_bytes(size)) return false;
  const std::size_t count = writer_.write(static_cast<std::uint8_t>(id), payload, size, wire_);
  board_.transmit(wire_, count);
  return true;
}

void Link::send_reply() {
  const Outgoing* reply = dispatcher_.reply();
  if (reply == nullptr) return;
  std::memcpy(payload_, reply->payload, reply->size);
  // Device time and counters as of the moment of sending, for the host's clock fit.
  if (reply->id == MessageId::pong) {
    auto pong = PongMessage::read(payload_);
    pong.tick = now();
    pong.write(payload_);
  } else if (reply->id == MessageId::welcome) {
    auto welcome = WelcomeMessage::read(payload_);
    welcome.tick = now();
    welcome.write(payload_);
  } else if (reply->id == MessageId::status) {
    status(payload_[0]).write(payload_);
  }
  if (send(reply->id, payload_, reply->size)) dispatcher_.sent();
}

void Link::send_events() {
  std::uint8_t payload[EventMessage::kSize];
  while (const EventMessage* event = events_.front()) {
    event->write(payload);
    if (!send(MessageId::event, payload, sizeof payload)) return;
    events_.pop();
  }
  while (const EventMessage* event = dispatcher_.events().front()) {
    event->write(payload);
    if (!send(MessageId::event, payload, sizeof payload)) return;
    dispatcher_.events().pop();
  }
}

void Link::send_status() {
  const std::uint32_t age_ticks = now() - status_tick_;
  if (age_ticks < kStatusTicks) return;
  // Wait until a batch has just been sent: the status takes 2 ms on the line, which would delay a
  // batch that is nearly full.
  if (batch_count_ > 0 && age_ticks < kStatusTicks + kMaxBatchTicks) return;
  std::uint8_t payload[StatusMessage::kSize];
  status(0).write(payload);
  if (send(MessageId::status, payload, sizeof payload)) status_tick_ = now();
}

// Counters of both contexts. `request`: the number that the answer repeats, 0 if unasked.
StatusMessage Link::status(std::uint8_t request) const {
  constexpr auto kRelaxed = std::memory_order_relaxed;
  StatusMessage message;
  message.request = request;
  message.tick = now();
  message.frames_ok = parser_.frames_ok();
  message.frames_bad = parser_.frames_bad();
  message.frames_lost = parser_.frames_lost();
  message.duplicates = dispatcher_.duplicates();
  message.stale_streams = dispatcher_.stale_streams() + stale_streams_.load(kRelaxed);
  message.ticks_dropped = ticks_dropped_ + samples_lost_.load(kRelaxed);
  message.overruns = overruns_.load(kRelaxed);
  message.tick_max_us = tick_max_us_.load(kRelaxed);
  message.illegal_elevation = illegal_[kElevation].load(kRelaxed);
  message.illegal_pitch = illegal_[kPitch].load(kRelaxed);
  message.illegal_travel = illegal_[kTravel].load(kRelaxed);
  message.setpoint_rate_Hz = setpoint_rate_Hz_.load(kRelaxed);
  return message;
}

// Collects samples until a batch is full or a tick is missing, then sends it. Without a session the
// samples are dropped.
void Link::send_telemetry() {
  if (!dispatcher_.session_open()) {
    while (samples_.front() != nullptr) samples_.pop();
    batch_count_ = 0;
    batch_bytes_ = 0;
    return;
  }
  while (const Sample* next = samples_.front()) {
    const bool gap = batch_count_ > 0 && next->tick != batch_[batch_count_ - 1].tick + 1;
    if ((gap || batch_count_ >= batch_ticks_) && !flush_batch()) {
      if (samples_.size() < kBatchPatience) return;
      ticks_dropped_ += static_cast<std::uint32_t>(batch_count_);
      batch_count_ = 0;
      batch_bytes_ = 0;
    }
    batch_[batch_count_++] = *next;
    samples_.pop();
  }
  if (batch_count_ >= batch_ticks_) flush_batch();
}

// Sends the batch, in several messages if it does not fit one. False if some of it could not be
// sent.
bool Link::flush_batch() {
  // Called in every turn of the idle loop: it packs again only when there is room for the result.
  while (batch_count_ > 0 && board_.transmit_free() >= batch_bytes_) {
    const Packed packed = pack_batch(batch_, batch_count_, payload_);
    batch_bytes_ = FrameWriter::wire_bytes(packed.bytes);
    if (!send(MessageId::telemetry, payload_, packed.bytes)) return false;
    batch_bytes_ = 0;
    batch_count_ -= packed.samples;
    for (std::size_t k = 0; k < batch_count_; ++k) batch_[k] = batch_[k + packed.samples];
  }
  return batch_count_ == 0;
}

}  // namespace heli::link
