// Three incremental encoders: elevation and pitch in hardware decoders, travel by interrupt.
#pragma once

#include "board.hpp"

namespace heli::due::encoders {

void start();

// Control tick only: it counts the decoders' errors since the call before, and gives travel's
// interrupt the edges that it may serve until the next.
EncoderReading read();

}  // namespace heli::due::encoders
