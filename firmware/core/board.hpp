// The small interface that a board gives to the flight code.
//
// Three boards implement it: firmware/due (registers), sim/native (this machine) and, through the
// same registers as firmware/due, the emulated Due. Nothing above this file knows which one it is.
#pragma once

#include <cstddef>
#include <cstdint>

#include "link/declaration.hpp"

namespace heli {

// Indices of per-axis arrays everywhere in the core.
inline constexpr auto kElevation = static_cast<std::size_t>(link::Axis::elevation);
inline constexpr auto kPitch = static_cast<std::size_t>(link::Axis::pitch);
inline constexpr auto kTravel = static_cast<std::size_t>(link::Axis::travel);
using link::kAxisCount;

struct EncoderReading {
  std::int32_t count[kAxisCount];     // free-running raw counts, x4
  std::uint32_t illegal[kAxisCount];  // illegal transitions since power-up; wraps
  // 0 while every edge is counted. Otherwise the edges came faster than the board can count: it
  // counted this many since the previous reading and missed others, so the count is wrong.
  std::uint32_t overload_edges;
};

struct MotorCommand {
  std::int16_t front_duty;  // -duty_full() ... duty_full(); the sign is the direction
  std::int16_t back_duty;
  bool enable;  // false: both bridges off (coast), whatever the duties
};

// Why the board last started; see link::Reset and link::Fault for the codes.
struct BootReport {
  std::uint8_t board;  // 0 native, 1 Arduino Due
  std::uint8_t reset;
  std::uint8_t boot_fault;
  std::uint32_t boot_id;  // 24 random bits, new at every start
};

class Board {
 public:
  // The duty that is the whole supply: 1 to 10,000 steps, the most that the core can tell apart at
  // the lowest supply. Always the same.
  virtual std::int16_t duty_full() = 0;

  virtual EncoderReading read_encoders() = 0;
  virtual void write_motors(const MotorCommand& command) = 0;
  // True while the hardware stop input switches the drivers off, without software.
  virtual bool hardware_stop() = 0;

  // Takes up to `most` received bytes; returns how many. Never waits.
  virtual std::size_t receive(std::uint8_t* to, std::size_t most) = 0;
  // Number of bytes that transmit() can take now without waiting.
  virtual std::size_t transmit_free() = 0;
  // Queues bytes; transmit_free() has shown the caller that there is room.
  virtual void transmit(const std::uint8_t* bytes, std::size_t count) = 0;

  // A page of flash is erased at once; its size depends on the board. The parameter store owns
  // pages 0 and 1 and uses the first params::kSetBytes of each: a board whose flash has smaller
  // pages joins some. `count` is a multiple of 4.
  virtual void read_page(std::size_t page, std::uint8_t* to, std::size_t count) = 0;
  // Erases one page and writes its first `count` bytes; false when that did not work or they do
  // not fit. May stop the processor for milliseconds: only while motors are off.
  virtual bool write_page(std::size_t page, const std::uint8_t* from, std::size_t count) = 0;

  virtual BootReport boot_report() = 0;

 protected:
  ~Board() = default;
};

}  // namespace heli
