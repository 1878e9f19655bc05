// The state table as the compiler works it out. The prover would work it out for every path.
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

template <std::size_t... k>
std::uint8_t cell_of(std::size_t place, std::index_sequence<k...>) {
  const std::uint8_t cells[] = {Cell<k>::value...};
  return cells[place];
}

inline std::uint8_t next_state(State from, Trigger on) {
  return cell_of(
      static_cast<std::size_t>(from) * link::kTriggerCount + static_cast<std::size_t>(on),
      std::make_index_sequence<link::kStateCount * link::kTriggerCount>{});
}

}  // namespace heli::flight
