// Any bytes on the line: the flight code must survive a stream that no host would send.
#include "harness.hpp"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* bytes, std::size_t count) {
  heli_fuzz::Harness harness;
  for (std::size_t at = 0; at < count; at += heli_fuzz::Harness::kLineBytes) {
    const std::size_t left = count - at;
    const std::size_t now =
        left < heli_fuzz::Harness::kLineBytes ? left : heli_fuzz::Harness::kLineBytes;
    harness.board.will_receive(bytes + at, now);
    harness.tick();
  }
  harness.require_rest_without_host();
  return 0;
}
