// The board's end of the link, as the control tick and the idle loop use it.
//
// Two contexts use one Link. The tick (an interrupt) may call what is under "tick"; it never waits
// and never meets a half-written value. The idle loop calls poll(), which does everything slow:
// parsing, answering, packing, transmitting, writing flash.
#pragma once

#include <atomic>
#include <cstddef>
#include <cstdint>

#include "board.hpp"
#include "law/tape.hpp"
#include "link/declaration.hpp"
#include "link/dispatch.hpp"
#include "link/frame_writer.hpp"
#include "link/mailbox.hpp"
#include "link/parser.hpp"
#include "link/spsc.hpp"
#include "link/telemetry.hpp"
#include "params/params.hpp"
#include "params/store.hpp"

namespace heli::link {

// Counters that the tick owns and the status message carries.
struct TickCounters {
  std::uint32_t overruns = 0;       // ticks that ran late
  std::uint32_t stale_streams = 0;  // streamed values that the tick refused
  std::uint16_t tick_max_us = 0;
  std::uint16_t illegal[heli::kAxisCount] = {};
  std::uint16_t setpoint_rate_Hz = 0;
};

class Link {
 public:
  // ticks_since_host_frame() while no session is open.
  static constexpr std::uint32_t kNever = 0xffffffffU;

  Link(Board& board, params::Params& params, params::Store& store, law::Tape& tape,
       const ControllerNames& controllers);

  // Idle loop: call it repeatedly. Bounded work, never waits.
  void poll();

  // Tick: first thing in it; the clock of everything that poll() sends.
  void begin_tick(std::uint32_t tick) { tick_.store(tick, std::memory_order_relaxed); }

  // Tick: the command to execute now, or null. Answer it in the same tick with answer().
  // Its floats are finite; enumerations, masks, ranges and the state are the tick's to check.
  // params_save: answer ok only when idle; poll() then writes the flash and sends the ack.
  // params_default, param_set: change Params here; poll() reads it only while no request waits.
  const Request* take_request() const { return mailbox_.take(); }
  void answer(const Reply& reply) { mailbox_.answer(reply); }

  // Tick: the next streamed value, floats finite; call until false, the last one wins.
  bool take_stream(StreamValue& value);

  // Tick, once at its end: fill in all of what next_sample() gives, then commit_sample(). A sample
  // for which there is no room, because the idle loop is late, is lost and counted.
  Sample& next_sample();
  void commit_sample(const Sample& sample);
  void publish(const TickCounters& counters);

  // Tick (before the first tick: anyone). The newest is lost when sixteen wait.
  void push_event(const EventMessage& event) { events_.push(event); }

  // Tick: age of the last valid frame from the host of the open session.
  std::uint32_t ticks_since_host_frame() const;

 private:
  void receive();
  void accept(const Frame& frame);
  bool send(MessageId id, const std::uint8_t* payload, std::size_t size);
  void send_reply();
  void send_events();
  void send_status();
  void send_telemetry();
  bool flush_batch();
  void read_batch_ticks();
  StatusMessage status(std::uint8_t request) const;
  std::uint32_t now() const { return tick_.load(std::memory_order_relaxed); }

  Board& board_;
  const params::Params& params_;

  // Between the contexts.
  std::atomic<std::uint32_t> tick_{0};
  std::atomic<std::uint32_t> host_frame_tick_{0};
  std::atomic<bool> session_open_{false};
  std::atomic<std::uint32_t> overruns_{0};
  std::atomic<std::uint32_t> stale_streams_{0};
  std::atomic<std::uint32_t> samples_lost_{0};
  std::atomic<std::uint16_t> tick_max_us_{0};
  std::atomic<std::uint16_t> illegal_[heli::kAxisCount] = {};
  std::atomic<std::uint16_t> setpoint_rate_Hz_{0};
  Mailbox mailbox_;
  StreamQueue streams_;
  SampleRing samples_;
  Sample lost_sample_;  // the tick's alone
  Spsc<EventMessage, 16> events_;

  // Idle loop only.
  Parser parser_;
  FrameWriter writer_;
  Dispatcher dispatcher_;
  Sample batch_[kMaxBatchTicks];
  std::size_t batch_count_ = 0;
  std::size_t batch_bytes_ = 0;  // room that the full batch needs; 0: not packed yet
  std::size_t batch_ticks_ = 0;
  std::uint32_t ticks_dropped_ = 0;
  std::uint32_t status_tick_ = 0;
  std::uint8_t payload_[kMaxTelemetryPayload] = {};
  std::uint8_t wire_[FrameWriter::wire_bytes(kMaxTelemetryPayload)] = {};
};

}  // namespace heli::link
