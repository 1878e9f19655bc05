// Telemetry: one sample per tick, packed into delta-coded batches as docs/reference/link.md says.
#pragma once

#include <cstddef>
#include <cstdint>

#include "link/declaration.hpp"
#include "link/spsc.hpp"

// Telemetry: one sample per tick, packed into delta-coded batches as docs/reference/link.md says.
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

// Fills in a sample; does not compile while a declared channel is left out or filled in twice.

// A chain of put<Channel::...>(raw), whose type knows the channels written so far, and done().
template <std::uint64_t kWritten = 0>
class SampleWriter {
 public:
  explicit SampleWriter(Sample& sample) : sample_(sample) {}

  template <Channel kChannel>
  auto put(std::int32_t raw) const {
    constexpr std::uint64_t kBit = std::uint64_t{1} << static_cast<unsigned>(kChannel);
    static_assert((kWritten & kBit) == 0U, "this channel is put() twice");
    sample_.raw[static_cast<std::size_t>(kChannel)] = raw;
    return SampleWriter<(kWritten | kBit)>(sample_);
  }

  void done() const {
    static_assert(kChannelCount < 64U, "one bit for each channel");
    static_assert(kWritten == (std::uint64_t{1} << kChannelCount) - 1U,
                  "link.toml declares a channel that is never put(): put it in log_tick()");
  }

 private:
  Sample& sample_;
};

}  // namespace heli::link
