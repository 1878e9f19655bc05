// A law as data (a "tape" of instructions): uploaded in parts, verified, then called periodically.
//
// The idle loop receives and verifies, the tick runs. Each writes one byte that the other only
// reads. The tick starts a law only if the byte says `ready`. The idle loop first withdraws
// `ready`, and changes the tape only if no law flies.
#pragma once

#include <atomic>
#include <cstddef>
#include <cstdint>

#include "law/soft_float.hpp"
#include "link/declaration.hpp"

namespace heli::law {

using link::LawError;
using link::LawState;

// The header of an upload: how many cells and words each part has. Cells are, in this order:
// inputs, constants, parameters, states, and cells that instructions write.
struct Shape {
  std::uint32_t divisor = 1;  // a call begins every `divisor` ticks
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

// Bits of an axis' inputs that derive from a moving setpoint: its rate and acceleration.
constexpr std::uint32_t moving_inputs(std::uint32_t axis) {
  return 1U << (static_cast<std::uint32_t>(link::LawInput::elevation_setpoint_rad_s) + axis) |
         1U << (static_cast<std::uint32_t>(link::LawInput::elevation_setpoint_rad_s2) + axis);
}

// Result of a check: the error, and where it is; see link::LawError.
struct UploadCheck {
  LawError error = LawError::none;
  std::uint32_t value = 0;
};

class Tape {
 public:
  // Idle loop.
  // One call per message of the host.
  UploadCheck begin(const link::LawBeginMessage& message);
  UploadCheck receive(const link::LawPartMessage& message);
  // Verifies the upload; if it passes, `value` is the cost of a call in instructions.
  UploadCheck end();
  std::uint32_t hash() const { return state() == LawState::none ? 0U : hash_; }
  std::uint32_t cost() const { return cost_; }

  // Any context.
  LawState state() const { return flying() ? LawState::flying : stored(); }
  bool flying() const { return flying_.load(std::memory_order_relaxed); }
  const Shape& shape() const { return shape_; }
  // Ticks over which a call is spread.
  std::uint32_t ticks() const { return ticks_; }

  // Tick, and only while `ready` or `flying`.
  void fly(bool on) { flying_.store(on, std::memory_order_release); }
  void restart();
  void set_input(std::size_t input, Bits value) { cells_[input] = value; }
  // Runs the `tick`-th tick of a call; true when the outputs are new.
  bool run(std::uint32_t tick);
  Bits output(std::size_t place) const { return cells_[image_[outputs_at_ + place]]; }
  // Whether an output is an unchanged input.
  bool passes_input(std::size_t place, std::size_t input) const {
    return image_[outputs_at_ + place] == input;
  }
  // One bit per input that the law reads.
  std::uint32_t inputs_read() const { return inputs_read_; }
  // False: a new state is not finite.
  bool commit_states();
  bool set_parameter(std::uint32_t index, Bits value);

 private:
  static constexpr std::size_t kCells = link::kLawCells;
  static constexpr std::size_t kWords = link::kLawWords;

  // Steps of end(), in this order.
  UploadCheck check();
  UploadCheck read_shape();
  UploadCheck check_numbers() const;
  UploadCheck check_program();
  UploadCheck schedule();
  void prepare();
  void execute(const std::uint32_t* instruction, const std::uint32_t* end);

  LawState stored() const { return stored_.load(std::memory_order_acquire); }
  void store(LawState state) { stored_.store(state, std::memory_order_release); }

  std::atomic<LawState> stored_{LawState::none};
  std::atomic<bool> flying_{false};
  std::uint32_t hash_ = 0;
  std::uint32_t expected_ = 0;  // words of the upload
  std::uint32_t received_ = 0;  // words received so far
  Shape shape_;
  std::uint32_t outputs_at_ = 0;  // index in the image of the first output's cell number
  std::uint32_t program_at_ = 0;  // index in the image of the first instruction
  std::uint32_t cost_ = 0;        // of a call, in processor instructions
  std::uint32_t ticks_ = 1;
  std::uint32_t inputs_read_ = 0;  // one bit per input
  // Index past the last instruction of each tick of a call.
  std::uint16_t ends_[link::kLawMaxTicks] = {};
  std::uint32_t image_[kWords] = {};  // the upload: head, numbers, output cells, program
  Bits cells_[kCells] = {};           // memory of the running law
};

}  // namespace heli::law
