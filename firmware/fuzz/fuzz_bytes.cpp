// Any bytes on the line: what the flight code does with a stream that no host would send.
#include "desk.hpp"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* bytes, std::size_t count) {
  heli_fuzz::Desk desk;
  for (std::size_t at = 0; at < count; at += heli_fuzz::Desk::kLineBytes) {
    const std::size_t left = count - at;
    const std::size_t now = left < heli_fuzz::Desk::kLineBytes ? left : heli_fuzz::Desk::kLineBytes;
    desk.board.will_receive(bytes + at, now);
    desk.tick();
  }
  desk.require_rest_without_host();
  return 0;
}
