// The supervisor as data: what each state does on each trigger. A pair not listed is refused.
//
//   idle --arm--> armed --close_loop--> closed_loop --stale_hold--> hold --stale_land--> landing
//                       --open_loop---> open_loop   --stale_hold--> idle  (a bench, no flight)
//                       --stream------> streamed    --stale_hold--> hold
//   landing --touchdown--> idle; with motors: stop --> idle, trip --> fault --clear--> idle
//   in the air --axis_lost--> emergency_landing --touchdown--> fault
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

#include "link/declaration.hpp"

namespace heli::flight {

using link::State;
using link::Trigger;

struct Transition {
  State from;
  Trigger on;
  State to;
};

inline constexpr Transition kTransitions[] = {
    {State::idle, Trigger::arm, State::armed},
    {State::idle, Trigger::stop, State::idle},
    {State::idle, Trigger::trip, State::fault},

    {State::armed, Trigger::stop, State::idle},
    {State::armed, Trigger::land, State::idle},
    {State::armed, Trigger::close_loop, State::closed_loop},
    {State::armed, Trigger::open_loop, State::open_loop},
    {State::armed, Trigger::stream, State::streamed},
    {State::armed, Trigger::stale_land, State::idle},
    {State::armed, Trigger::trip, State::fault},

    {State::closed_loop, Trigger::stop, State::idle},
    {State::closed_loop, Trigger::close_loop, State::closed_loop},
    {State::closed_loop, Trigger::open_loop, State::open_loop},
    {State::closed_loop, Trigger::stream, State::streamed},
    {State::closed_loop, Trigger::land, State::landing},
    {State::closed_loop, Trigger::stale_hold, State::hold},
    {State::closed_loop, Trigger::trip, State::fault},
    {State::closed_loop, Trigger::axis_lost, State::emergency_landing},

    {State::open_loop, Trigger::stop, State::idle},
    {State::open_loop, Trigger::close_loop, State::closed_loop},
    {State::open_loop, Trigger::open_loop, State::open_loop},
    {State::open_loop, Trigger::stream, State::streamed},
    {State::open_loop, Trigger::land, State::landing},
    {State::open_loop, Trigger::stale_hold, State::idle},
    {State::open_loop, Trigger::trip, State::fault},

    {State::streamed, Trigger::stop, State::idle},
    {State::streamed, Trigger::close_loop, State::closed_loop},
    {State::streamed, Trigger::open_loop, State::open_loop},
    {State::streamed, Trigger::stream, State::streamed},
    {State::streamed, Trigger::land, State::landing},
    {State::streamed, Trigger::stale_hold, State::hold},
    {State::streamed, Trigger::trip, State::fault},
    {State::streamed, Trigger::axis_lost, State::emergency_landing},

    {State::hold, Trigger::stop, State::idle},
    {State::hold, Trigger::close_loop, State::closed_loop},
    {State::hold, Trigger::stream, State::streamed},
    {State::hold, Trigger::land, State::landing},
    {State::hold, Trigger::setpoint_fresh, State::closed_loop},
    {State::hold, Trigger::stale_land, State::landing},
    {State::hold, Trigger::trip, State::fault},
    {State::hold, Trigger::axis_lost, State::emergency_landing},

    {State::landing, Trigger::stop, State::idle},
    {State::landing, Trigger::close_loop, State::closed_loop},
    {State::landing, Trigger::land, State::landing},
    {State::landing, Trigger::touchdown, State::idle},
    {State::landing, Trigger::trip, State::fault},
    {State::landing, Trigger::axis_lost, State::emergency_landing},

    {State::emergency_landing, Trigger::stop, State::idle},
    {State::emergency_landing, Trigger::land, State::emergency_landing},
    {State::emergency_landing, Trigger::touchdown, State::fault},
    {State::emergency_landing, Trigger::trip, State::fault},
    {State::emergency_landing, Trigger::axis_lost, State::emergency_landing},

    {State::fault, Trigger::stop, State::fault},
    {State::fault, Trigger::trip, State::fault},
    {State::fault, Trigger::clear, State::idle},
};

inline constexpr std::uint8_t kRefused = 0xff;
using StateTable = std::array<std::array<std::uint8_t, link::kTriggerCount>, link::kStateCount>;

constexpr StateTable make_state_table() {
  StateTable table{};
  for (auto& row : table) {
    for (auto& cell : row) {
      cell = kRefused;
    }
  }
  for (const Transition& t : kTransitions) {
    table[static_cast<std::size_t>(t.from)][static_cast<std::size_t>(t.on)] =
        static_cast<std::uint8_t>(t.to);
  }
  return table;
}

inline constexpr StateTable kStateTable = make_state_table();

constexpr std::uint8_t next_state(State from, Trigger on) {
  return kStateTable[static_cast<std::size_t>(from)][static_cast<std::size_t>(on)];
}

constexpr bool motors_enabled(State state) { return state != State::idle && state != State::fault; }

constexpr bool descends(State state) {
  return state == State::landing || state == State::emergency_landing;
}

constexpr bool pairs_are_unique() {
  for (const Transition& a : kTransitions) {
    int same = 0;
    for (const Transition& b : kTransitions) {
      same += (a.from == b.from && a.on == b.on) ? 1 : 0;
    }
    if (same != 1) {
      return false;
    }
  }
  return true;
}

constexpr bool always(Trigger on, State to, State except) {
  for (std::size_t s = 0; s < link::kStateCount; ++s) {
    const auto from = static_cast<State>(s);
    if (from != except && next_state(from, on) != static_cast<std::uint8_t>(to)) {
      return false;
    }
  }
  return true;
}

static_assert(pairs_are_unique(), "two rows of the state table answer the same trigger");
static_assert(always(Trigger::stop, State::idle, State::fault), "stop must work in every state");
static_assert(always(Trigger::trip, State::fault, State::fault), "a fault must stop every state");
static_assert(next_state(State::fault, Trigger::arm) == kRefused, "a fault is latched");
static_assert(next_state(State::emergency_landing, Trigger::close_loop) == kRefused,
              "nothing is flown on with a fault");

}  // namespace heli::flight
