// Frames and movements in any order, for a fifth of a second: enough for every state, since the
// times after which the board acts by itself are set short. What takes longer is fuzz_silence's.
#include <cstddef>
#include <cstdint>

#include "story.hpp"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* bytes, std::size_t count) {
  constexpr std::size_t kMax_ticks = 200;
  heli_fuzz::Story story(heli_fuzz::Input(bytes, count), heli_fuzz::Story::Times::short_ones);
  story.play(kMax_ticks);
  story.host_returns();
  return 0;
}
