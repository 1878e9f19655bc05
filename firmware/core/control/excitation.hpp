// Excitation generated on board and added to the motor voltages, bounded in amplitude and time.
#pragma once

#include <cstdint>

#include "control/fixed.hpp"
#include "link/declaration.hpp"

namespace heli::control {

struct ExcitationValue {
  Quantity front_V;
  Quantity back_V;
};

class Exciter {
 public:
  static constexpr std::uint32_t kTones = 8;  // of a multisine, per motor

  // The caller has checked amplitude and duration against the parameters.
  void start(const link::ExciteMessage& message);
  void stop() { kind_ = link::Excitation::none; }
  bool running() const { return kind_ != link::Excitation::none; }
  link::Excitation kind() const { return kind_; }

  // Value for this tick. The call after the last tick of the duration stops the excitation.
  ExcitationValue next();

 private:
  // Phase step of the first tone, and the difference between the last tone's and the first's.
  void start_tones(std::uint32_t start, std::uint32_t spread);
  // Value of the signal between -1 and 1 for a motor (0 front, 1 back); advances a multisine.
  Share unit_amplitude(std::size_t motor);

  link::Excitation kind_ = link::Excitation::none;
  Quantity amplitude_V_[2];
  std::uint32_t tick_ = 0;
  std::uint32_t duration_ticks_ = 0;
  std::uint32_t phase_[2][kTones] = {};  // 2^32 is one turn
  std::uint32_t step_[2][kTones] = {};   // turns per tick, same scale
  float chirp_step_ = 0.0F;              // current step as float: its growth is below one unit
  float chirp_growth_ = 0.0F;
  std::uint32_t prbs_register_ = 1;  // of a xorshift32 generator; never 0
};

}  // namespace heli::control
