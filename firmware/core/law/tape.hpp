// A law as data: uploaded in parts, verified, then run a call at a time.
//
// The idle loop receives and verifies, the tick runs. Each has a byte of its own that the other
// only reads: the tick begins to fly only what is ready, and the idle loop, once it has said that
// nothing is, touches the tape only if nothing flies.
#pragma once

#include <atomic>
#include <cstddef>
#include <cstdint>

#include "law/soft_float.hpp"
#include "link/declaration.hpp"

namespace heli::law {

using link::LawError;
using link::LawState;

// What the first words of an upload say.
struct Shape {
  std::uint32_t divisor = 1;
  std::uint32_t signals = 0;
  std::uint32_t parameters = 0;
  std::uint32_t constants = 0;
  std::uint32_t states = 0;
  std::uint32_t instructions = 0;

  std::uint32_t outputs() const { return kFirstSignal + signals + states; }
  std::uint32_t words() const {
    return kHeadWords + constants + parameters + states + outputs() + instructions;
  }
  std::uint32_t first_parameter() const { return link::kLawInputCount + constants; }
  std::uint32_t first_state() const { return first_parameter() + parameters; }
  std::uint32_t first_written() const { return first_state() + states; }

  static constexpr std::uint32_t kHeadWords = 3;
  // Before the signals come two voltages and three setpoints.
  static constexpr std::uint32_t kFirstSetpoint = 2;
  static constexpr std::uint32_t kFirstSignal = kFirstSetpoint + link::kAxisCount;
};

// A bit for each input of an axis that moves with its setpoint: rate and acceleration.
constexpr std::uint32_t moving_inputs(std::uint32_t axis) {
  return 1U << (static_cast<std::uint32_t>(link::LawInput::elevation_setpoint_rad_s) + axis) |
         1U << (static_cast<std::uint32_t>(link::LawInput::elevation_setpoint_rad_s2) + axis);
}

// What was found wrong, and where; see link::LawError.
struct Finding {
  LawError error = LawError::none;
  std::uint32_t value = 0;
};

class Tape {
 public:
  // Idle loop.
  Finding begin(const link::LawBeginMessage& message);
  Finding receive(const link::LawPartMessage& message);
  // Verifies what was received; `value` of the finding is then the cost of a call.
  Finding end();
  std::uint32_t hash() const { return state() == LawState::none ? 0U : hash_; }
  std::uint32_t cost() const { return cost_; }

  // Any.
  LawState state() const { return flying() ? LawState::flying : stored(); }
  bool flying() const { return flying_.load(std::memory_order_relaxed); }
  const Shape& shape() const { return shape_; }
  std::uint32_t ticks() const { return ticks_; }

  // Tick, and only while `ready` or `flying`.
  void fly(bool on) { flying_.store(on, std::memory_order_release); }
  void restart();
  void set_input(std::size_t input, Bits value) { cells_[input] = value; }
  // Runs what the `tick`-th tick of a call has to do; true when the outputs are new.
  bool run(std::uint32_t tick);
  Bits output(std::size_t place) const { return cells_[image_[outputs_at_ + place]]; }
  // Whether an output is an input as it came.
  bool passes(std::size_t place, std::size_t input) const {
    return image_[outputs_at_ + place] == input;
  }
  // A bit for each input that the law reads.
  std::uint32_t inputs_read() const { return inputs_read_; }
  // False: one of them is not finite.
  bool take_new_states();
  bool set_parameter(std::uint32_t index, Bits value);

 private:
  static constexpr std::size_t kCells = link::kLawCells;
  static constexpr std::size_t kWords = link::kLawWords;

  Finding check();
  Finding check_numbers() const;
  Finding check_instructions();
  Finding spread();
  void prepare();
  void execute(const std::uint32_t* from, const std::uint32_t* to);

  LawState stored() const { return stored_.load(std::memory_order_acquire); }
  void store(LawState state) { stored_.store(state, std::memory_order_release); }

  std::atomic<LawState> stored_{LawState::none};
  std::atomic<bool> flying_{false};
  std::uint32_t hash_ = 0;
  std::uint32_t expected_ = 0;  // words
  std::uint32_t received_ = 0;
  Shape shape_;
  std::uint32_t outputs_at_ = 0;  // in the image
  std::uint32_t program_at_ = 0;
  std::uint32_t cost_ = 0;
  std::uint32_t ticks_ = 1;
  std::uint32_t inputs_read_ = 0;
  // Behind the last instruction of each tick of a call.
  std::uint16_t ends_[link::kLawMostTicks] = {};
  std::uint32_t image_[kWords] = {};
  Bits cells_[kCells] = {};
};

}  // namespace heli::law
