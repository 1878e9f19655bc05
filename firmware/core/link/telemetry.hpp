// Telemetry: one sample per tick, packed into delta-coded batches as docs/reference/link.md says.
#pragma once

#include <cstddef>
#include <cstdint>

#include "link/declaration.hpp"
#include "link/spsc.hpp"

namespace heli::link {

// Every channel of one tick, in wire units; each value must fit its channel's type.
struct Sample {
  std::uint32_t tick = 0;
  std::int32_t raw[kChannelCount] = {};
};

// 64 ticks: the idle loop may be busy this many milliseconds before a tick is lost.
using SampleRing = Spsc<Sample, 64>;

inline constexpr std::size_t kMaxBatchTicks = 32;

struct Packed {
  std::size_t samples;  // how many of the samples went in
  std::size_t bytes;    // length of the payload
};

// Packs the longest of count, count/2, count/4 ... samples whose payload is at most
// kMaxTelemetryPayload bytes. The ticks must be consecutive and count in 1...kMaxBatchTicks.
Packed pack_batch(const Sample* samples, std::size_t count, std::uint8_t* to);

}  // namespace heli::link
