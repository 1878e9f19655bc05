// Measurements and states of one tick, collected after its encoders were read.
#pragma once

#include <cstdint>

#include "board.hpp"
#include "control/fixed.hpp"

namespace heli::flight {

using control::Quantity;

// Motor voltages that no control law on the board decides: open loop, or streamed by the host.
struct OpenVoltages {
  Quantity front_V;
  Quantity back_V;
};

// Written by the core, in the tick only.
struct Observation {
  std::uint32_t tick = 0;
  Quantity angle_rad[kAxisCount];
  Quantity rate_rad_s[kAxisCount];
  std::int32_t count[kAxisCount] = {};  // of the encoder, wraps
  std::uint8_t steps = 0;  // link::axes bits: readings that changed faster than the arm can turn
  std::int32_t step_counts = 0;  // of the last such step
  std::uint32_t illegal[kAxisCount] =
      {};                            // encoder transitions that cannot be, since power-up; wraps
  std::uint32_t overload_edges = 0;  // of this tick, see EncoderReading
  std::uint32_t overruns = 0;        // late ticks since power-up
  bool hardware_stop = false;        // the stop input holds the motors off
  std::uint32_t link_age_ticks = 0;  // since the last valid frame of the host
  OpenVoltages applied;              // motor voltages of the previous tick
  Quantity pitch_setpoint_rad;       // that the control law used in it
  bool params_usable = false;        // the stored parameters were not corrupt
  bool law_busy = false;  // an uploaded law flies, or its take-over by the cascade has not ended
};

}  // namespace heli::flight
