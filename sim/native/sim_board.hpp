// What the simulated world needs of a board. NativeBoard is one; an emulated Due can be another.
#pragma once

#include <cstddef>
#include <cstdint>

#include "board.hpp"
#include "link/declaration.hpp"

namespace heli_sim {

// One step of a quadrature encoder. Its A and B lines follow from the count modulo 4.
struct Edge {
  double time_us;         // since the start of the millisecond, 0 <= time_us < 1000
  std::uint8_t axis;      // heli::kElevation, kPitch, kTravel
  std::int8_t direction;  // +1 or -1
};

// What the encoders do during one millisecond of the board's time.
struct EncoderInput {
  std::int32_t count[heli::kAxisCount];  // at the start of the millisecond, since power-up
  const Edge* edges;                     // in order of time; only for boards that want edges
  std::size_t edge_count;
};

struct MotorOutput {
  double front_duty;  // -1 ... 1
  double back_duty;
  bool enable;  // false: both bridges off
};

class SimBoard {
 public:
  virtual ~SimBoard() = default;

  // False: the board reads the count at the start of the millisecond and its motor command acts
  // during that millisecond. True: the board gets the edges of the millisecond as they happen,
  // and its motor command acts from the next millisecond on.
  virtual bool wants_edges() const = 0;

  // Lets one millisecond of the board's time pass.
  virtual void run(const EncoderInput& encoders) = 0;
  virtual MotorOutput motors() const = 0;

  // Stops the board as its reset line does: motors off, nothing sent or received.
  virtual void reset(heli::link::Reset cause) = 0;

  // One byte from the UART, and the next byte for it; false when there is none.
  virtual void uart_receive(std::uint8_t byte) = 0;
  virtual bool uart_transmit(std::uint8_t& byte) = 0;
};

}  // namespace heli_sim
