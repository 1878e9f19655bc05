// The emulated Due behind SimBoard, for the simulated world: it has its own serial line, so the USB
// bridge of the board stays out of the way.
//
// A millisecond is 84,000 cycles of board time. It begins just before the program's tick, the
// handler that align() names. The edges of a millisecond come after its command has reached the
// pins and before the next tick; its bytes come at 40 us each, the last one while that tick runs.
#pragma once

#include <array>
#include <cstdint>
#include <deque>
#include <memory>

#include "board/due.hpp"
#include "sim_board.hpp"
#include "wiring.hpp"

namespace heli_sim {

using due_emulator::BoardTime;

class DueBoard final : public SimBoard,
                       public due_emulator::SerialPeer,
                       public due_emulator::EventSink {
 public:
  // The 16U2 holds the reset line this long when the port is opened: 50 rounds of 4.096 ms.
  static constexpr BoardTime kResetTime =
      due_emulator::UsbBridge::kResetRounds * due_emulator::UsbBridge::kRound;

  DueBoard();

  // Sets the exception number of the control tick. Its command acts once the handler has returned
  // and a PWM period has ended. When a program starts, its first tick shifts the beginning of the
  // milliseconds, once. With 0 they are not aligned: the command is the state of the pins at the
  // end of the previous millisecond.
  void align(std::uint8_t handler);

  bool wants_edges() const override { return true; }
  // Both throw Stop when strict mode finds something, or when the processor locks up. The first
  // tick() of all switches the power on, and time begins with the program's first tick.
  void tick(const std::int32_t* count) override;
  void rest(const Edge* edges, std::size_t edge_count) override;
  MotorOutput motors() const override;
  // power_up switches the power off and on; every other cause pulls the reset line.
  void reset(heli::link::Reset cause) override;
  bool in_reset() const override { return reset_end_ != 0; }
  std::uint64_t boots() const override { return due_->chip.resets(); }
  void erase() override;
  void set_stop(bool pressed) override { heli_sim::set_stop(*due_, pressed); }
  void uart_receive(std::uint8_t byte) override { to_uart_.push_back({byte, 0}); }
  bool uart_transmit(std::uint8_t& byte) override;

  due_emulator::Due& due() { return *due_; }

  void byte_from_uart(std::uint8_t byte, std::uint32_t bit_cycles, std::uint64_t now) override;
  void event(std::uint64_t now) override;
  void clock_changed() override { plan(); }

 private:
  struct Arrival {
    std::uint8_t byte;
    BoardTime when;  // 0: not yet planned
  };

  void start();
  void run_until(BoardTime until);
  bool ticked();
  void wait_for_command();
  void plan_bytes();
  void plan();

  std::unique_ptr<due_emulator::Due> due_;
  due_emulator::Scheduler::Id id_;
  std::uint8_t handler_ = 0;  // exception number; 0: none
  BoardTime tick_at_ = 0;     // when this millisecond's tick begins
  bool aligned_ = false;
  std::uint64_t last_entry_ = 0;  // cycle of the handler's last entry that ticked() has seen
  std::array<std::int32_t, kEncoders>
      unreported_steps_{};  // difference between the rig's count and the board's
  std::deque<Arrival> to_uart_;
  BoardTime wire_free_time_ = 0;  // when the last byte to the chip has ended
  std::deque<std::uint8_t> from_uart_;
  std::size_t sendable_bytes_ = 0;  // bytes that the program has sent before this millisecond
  BoardTime reset_end_ = 0;         // when the reset line is released; 0: it is not pulled
};

}  // namespace heli_sim
