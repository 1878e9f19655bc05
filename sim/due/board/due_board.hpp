// The emulated Due behind SimBoard, for the simulated world: it has its own serial line, so the USB
// bridge of the board stays out of the way.
//
// A millisecond is 84,000 cycles of board time. Edges arrive as they happen; motors() is what the
// pins do at the end of the millisecond, so that it acts from the next one on.
#pragma once

#include <cstdint>
#include <deque>
#include <memory>

#include "board/due.hpp"
#include "sim_board.hpp"

namespace heli_due {

class DueBoard final : public heli_sim::SimBoard, public SerialPeer, public EventSink {
 public:
  // The 16U2 holds the reset line this long when the port is opened: 50 rounds of 4.096 ms.
  static constexpr BoardTime kResetTime = UsbBridge::kResetRounds * UsbBridge::kRound;

  DueBoard();

  bool wants_edges() const override { return true; }
  // Throws Stop when strict mode finds something, or when the processor locks up.
  void run(const heli_sim::EncoderInput& encoders) override;
  heli_sim::MotorOutput motors() const override;
  // power_up switches the power off and on; every other cause pulls the reset line.
  void reset(heli::link::Reset cause) override;
  void uart_receive(std::uint8_t byte) override;
  bool uart_transmit(std::uint8_t& byte) override;

  // Shifts the milliseconds once after each boot, so that the handler of exception `number`, which
  // runs every millisecond, begins `phase_us` into them; edges then come before it. A control tick
  // at 800 us sees all edges of its millisecond, and its command is at the pins before the end.
  void align(std::uint8_t number, double phase_us);

  Due& due() { return *due_; }

  void byte_from_uart(std::uint8_t byte, std::uint32_t bit_cycles, std::uint64_t now) override;
  void event(std::uint64_t now) override;
  void clock_changed() override { plan(); }

 private:
  void plan();
  void shift_phase(BoardTime start);

  std::unique_ptr<Due> due_;
  Scheduler::Id id_;
  BoardTime tick_end_ = 0;
  std::deque<std::uint8_t> to_uart_;
  std::deque<std::uint8_t> from_uart_;
  BoardTime byte_due_ = 0;  // when the byte on the wire is sampled; 0: the wire is idle
  BoardTime wire_free_ = 0;
  BoardTime reset_end_ = 0;
  std::uint8_t aligned_to_ = 0;  // exception number; 0: none
  BoardTime phase_ = kOneMs;
  bool aligned_ = false;
  std::uint64_t resets_seen_ = 0;
};

}  // namespace heli_due
