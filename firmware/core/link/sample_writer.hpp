// Fills in a sample; does not compile while a declared channel is left out or filled in twice.
#pragma once

#include <cstddef>
#include <cstdint>

#include "link/telemetry.hpp"

namespace heli::link {

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
