// What is known in a tick after its encoders were read.
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

struct Observation {
  std::uint32_t tick = 0;
  Quantity angle_rad[kAxisCount];
  Quantity rate_rad_s[kAxisCount];
  std::int32_t count[kAxisCount] = {};
  std::uint32_t illegal[kAxisCount] = {};  // since power-up; wraps
  std::uint32_t overload_edges = 0;        // of this tick, see EncoderReading
  std::uint32_t overruns = 0;              // since power-up
  bool hardware_stop = false;
  std::uint32_t link_age_ticks = 0;
  OpenVoltages acted;           // motor voltages of the previous tick
  Quantity pitch_setpoint_rad;  // that the control law used in it
  bool params_usable = false;
  bool law_busy = false;  // a law that came over the link flies, or has just been taken over from
};

}  // namespace heli::flight
