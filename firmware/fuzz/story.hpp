// A fuzzer's input as a story: valid frames with any content, in any order, between any movements
// of the rig. The input is a list of steps, each one byte and its operands. The first byte says in
// which state the story begins, so that the fuzzer reaches flight as easily as the handshake.
#pragma once

#include <cstdint>
#include <iterator>
#include <vector>

#include "harness.hpp"

namespace heli_fuzz {

enum class Step : std::uint8_t {
  frame,      // any id and payload
  command,    // a known id with the request number counted on
  setpoint,   // near level, due now
  voltages,   // a few volts
  hello,      // the right declaration, one of four sessions
  wait,       // up to 255 ms
  busy,       // up to 255 ms in which the idle loop does not turn
  move,       // encoders go elsewhere
  hardware,   // the stop input changes
  noise,      // bytes that are no frame
  line_full,  // the transmitter takes no more
  boot,       // reset; flash stays
  damage,     // one byte of flash changes
  count,
};

// Payload bytes of the commands, by their ids from 1 on.
inline constexpr std::uint8_t kCommandSizes[] = {0, 9, 9, 1, 1, 10, 1, 1, 26,
                                                 1, 6, 2, 1, 1, 2,  1, 1};

class Story {
 public:
  // The parameters after whose times the board acts by itself (hold, landing): set as short as
  // allowed, or as declared.
  enum class Times : std::uint8_t { short_ones, declared };

  Story(Input input, Times times) : input_(input), times_(times) {}

  // Plays steps until the input ends or `max_ticks` milliseconds have passed.
  void play(std::size_t max_ticks) {
    prologue(input_.byte() % 5U);
    ticks_left_ = max_ticks;
    while (!input_.empty() && ticks_left_ > 0) {
      step(static_cast<Step>(input_.byte() % static_cast<unsigned>(Step::count)));
      tick();
    }
  }

  // No host any more, and nothing stops the motors by hardware: the flight code must.
  void end_in_silence() {
    harness_.board.stop_input = false;
    harness_.require_rest_without_host();
  }

  // After all this, the board still accepts a new host.
  void host_returns() {
    harness_.board.forget_received();
    harness_.board.room = 1024;  // the line is free again
    // Ends a frame that the story left half sent.
    const std::uint8_t delimiter = 0;
    harness_.board.will_receive(&delimiter, 1);
    for (int k = 0; k < 3; ++k) harness_.tick();
    const std::size_t before = harness_.board.auditor.welcomes();
    hello(99);  // a session that the story has not used
    require(harness_.board.auditor.welcomes() == before + 1, "a new host is welcomed");
  }

 private:
  // One millisecond, unless the time has run out.
  void tick(bool poll = true) {
    if (ticks_left_ == 0) return;
    --ticks_left_;
    harness_.tick(poll);
  }

  // Brings the board into a state: 0 after boot, 1 with a host, 2 armed, 3 closed loop, 4 open
  // loop.
  void prologue(unsigned chapters) {
    if (chapters > 0) hello(1);
    if (chapters > 0 && times_ == Times::short_ones) {
      set(heli::link::Param::setpoint_hold_s, 0.05F);
      set(heli::link::Param::setpoint_land_s, 0.1F);
      set(heli::link::Param::landing_timeout_s, 1.0F);
    }
    if (chapters > 1) {
      command(heli::link::ArmMessage{});
      require(harness_.state() == State::armed, "a board at rest with a host can be armed");
    }
    heli::link::ControlMessage control;
    if (chapters == 3) {
      control.axes =
          heli::link::axes::elevation | heli::link::axes::pitch | heli::link::axes::travel;
      command(control);
      require(harness_.state() == State::closed_loop, "an armed board closes its loops");
    }
    if (chapters == 4) {
      control.front_V = 1.0F;
      control.back_V = 1.0F;
      command(control);
      require(harness_.state() == State::open_loop, "an armed board takes fixed voltages");
    }
  }

  // Plays one step, with operands from the input; see Step.
  void step(Step what) {
    switch (what) {
      case Step::frame: {
        const std::uint8_t id = input_.byte();
        return harness_.send(id, input_.take(input_.byte() % (heli::link::kMaxCommandPayload + 1)));
      }
      case Step::command: {
        const std::size_t id = 1U + input_.byte() % (std::size(kCommandSizes) - 1);
        std::vector<std::uint8_t> payload = input_.take(kCommandSizes[id]);
        payload[0] = ++request_;
        return harness_.send(static_cast<std::uint8_t>(id), payload);
      }
      case Step::setpoint: {
        heli::link::SetpointMessage setpoint;
        setpoint.elevation_rad = small(0.01F);
        setpoint.pitch_rad = small(0.01F);
        setpoint.travel_rad = small(0.01F);
        return harness_.send(setpoint);
      }
      case Step::voltages: {
        heli::link::VoltagesMessage voltages;
        voltages.front_V = small(0.1F);
        voltages.back_V = small(0.1F);
        voltages.valid_ms = input_.byte();
        return harness_.send(voltages);
      }
      case Step::hello:
        return hello(input_.byte() % 4U);
      case Step::wait:
      case Step::busy:
        for (std::size_t k = input_.byte(); k > 0; --k) tick(what == Step::wait);
        return;
      case Step::move:
        for (std::int32_t& count : harness_.board.encoders.count) {
          // Small steps for most bytes, the ends of the counter for some.
          const std::uint8_t by = input_.byte();
          count = by == 0x80 ? INT32_MIN : by == 0x7f ? INT32_MAX : count / 2 + (by - 128);
        }
        return;
      case Step::hardware:
        harness_.board.stop_input = !harness_.board.stop_input;
        return;
      case Step::noise: {
        const auto bytes = input_.take(input_.byte() % 100U);
        return harness_.board.will_receive(bytes.data(), bytes.size());
      }
      case Step::line_full:
        harness_.board.room = 0;
        return;
      case Step::boot:
        return harness_.boot();
      default: {
        const std::size_t page = input_.byte() % harness_.board.pages.size();
        harness_.board.pages[page][input_.byte()] = input_.byte();
        return;
      }
    }
  }

  // A host with the right declaration begins a session.
  void hello(std::uint32_t session) {
    heli::link::HelloMessage message;
    message.link_hash = heli::link::kLinkHash;
    message.session = session;
    command(message);
  }

  // Sets a parameter by a command.
  void set(heli::link::Param which, float value) {
    heli::link::ParamSetMessage message;
    message.index = static_cast<std::uint8_t>(which);
    message.value = value;
    command(message);
  }

  // Sends a command with the next request number and lets the board execute it.
  template <class Message>
  void command(Message message) {
    message.request = ++request_;
    harness_.send(message);
    for (int k = 0; k < 3; ++k) harness_.tick();
  }

  // A number of -128 to 127 units.
  float small(float unit) { return static_cast<float>(input_.byte() - 128) * unit; }

  Input input_;
  Harness harness_;
  Times times_;
  std::size_t ticks_left_ = 0;
  std::uint8_t request_ = 0;
};

}  // namespace heli_fuzz
