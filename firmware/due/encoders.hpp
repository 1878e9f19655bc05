// Three incremental encoders: elevation and pitch in hardware decoders, travel by interrupt.
#pragma once

#include "board.hpp"

namespace heli::due::encoders {

void start();

// Control tick only: it counts the decoders' errors since the call before.
EncoderReading read();

}  // namespace heli::due::encoders
