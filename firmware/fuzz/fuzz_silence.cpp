// The same stories, but then the host falls silent: the rotors come to rest, whatever has happened
// and whatever times were set, which can take two minutes of the board's.
#include <cstddef>
#include <cstdint>

#include "story.hpp"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* bytes, std::size_t count) {
  constexpr std::size_t kMax_ticks = 5000;
  heli_fuzz::Story story(heli_fuzz::Input(bytes, count), heli_fuzz::Story::Times::declared);
  story.play(kMax_ticks);
  story.end_in_silence();
  story.host_returns();
  return 0;
}
