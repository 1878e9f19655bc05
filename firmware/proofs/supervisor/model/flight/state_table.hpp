// The state table as the compiler computes it, entry by entry, because the prover would compute it
// again on every path.
#pragma once

#include <cstddef>
#include <utility>

#define next_state compiled_next_state
#include_next "flight/state_table.hpp"
#undef next_state

namespace heli::flight {

template <std::size_t k>
struct Cell {
  enum : std::uint8_t {
    value = compiled_next_state(static_cast<State>(k / link::kTriggerCount),
                                static_cast<Trigger>(k % link::kTriggerCount))
  };
};

// The entry at `place` of the whole table.
template <std::size_t... k>
std::uint8_t cell_of(std::size_t place, std::index_sequence<k...>) {
  const std::uint8_t cells[] = {Cell<k>::value...};
  return cells[place];
}

// In place of the flight code's next_state(): reads the table.
inline std::uint8_t next_state(State from, Trigger on) {
  return cell_of(
      static_cast<std::size_t>(from) * link::kTriggerCount + static_cast<std::size_t>(on),
      std::make_index_sequence<link::kStateCount * link::kTriggerCount>{});
}

}  // namespace heli::flight
