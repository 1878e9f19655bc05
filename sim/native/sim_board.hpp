// What the simulated world needs of a board: NativeBoard and the emulated Due are two.
//
// A millisecond of a board has two parts. In the first, tick(), its control tick reads the encoders
// and commands the motors. In the second, rest(), the rig moves under that command, and the
// encoders step. So the command of a tick acts during its own millisecond, on both boards.
#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>

#include "board.hpp"
#include "link/declaration.hpp"

namespace heli_sim {

// One step of a quadrature encoder. Its A and B lines follow from the count modulo 4.
struct Edge {
  double time_us;         // since the start of the millisecond, 0 <= time_us < 1000
  std::uint8_t axis;      // heli::kElevation, kPitch, kTravel
  std::int8_t direction;  // +1 or -1
};

struct MotorOutput {
  double front_duty;  // -1 ... 1
  double back_duty;
  bool enable;  // false: both bridges off
};

class SimBoard {
 public:
  virtual ~SimBoard() = default;

  // True: the board follows the edges of each millisecond. False: the counts are enough.
  virtual bool wants_edges() const = 0;

  // Lets time pass up to the motor command of this millisecond's control tick. `count` is where
  // the encoders' discs stand at the start of the millisecond, one for each axis.
  virtual void tick(const std::int32_t* count) = 0;
  virtual MotorOutput motors() const = 0;
  // Lets the rest of the millisecond pass; edges in order of time, none when they are not wanted.
  virtual void rest(const Edge* edges, std::size_t edge_count) = 0;

  // Pulls the board's reset line: motors off at once, nothing sent or received for about 205 ms.
  virtual void reset(heli::link::Reset cause) = 0;
  virtual bool in_reset() const = 0;
  // How often the program has been started.
  virtual std::uint64_t boots() const = 0;
  // What the 16U2 does at 1200 baud: the flash is empty, and no program starts any more.
  virtual void erase() = 0;
  // The hardware stop: a switch to ground that opens.
  virtual void set_stop(bool pressed) = 0;

  // One byte for the UART, heard by the end of the millisecond whose tick() comes next; and the
  // next byte from it, false when there is none. What the program writes in one millisecond leaves
  // from the next on: a processor takes part of this one to write it.
  virtual void uart_receive(std::uint8_t byte) = 0;
  virtual bool uart_transmit(std::uint8_t& byte) = 0;
};

// Asks a board for its versions (hello and welcome of the link), before anything is simulated with
// it. Lets up to `max_ms` milliseconds of the board's time pass. Empty when it does not answer.
std::optional<heli::link::WelcomeMessage> greet(SimBoard& board, std::uint32_t max_ms);

}  // namespace heli_sim
