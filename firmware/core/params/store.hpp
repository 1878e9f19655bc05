// Two copies of the parameters in flash, written in turn, so that one is always complete.
#pragma once

#include <atomic>
#include <cstddef>
#include <cstdint>

#include "board.hpp"
#include "link/declaration.hpp"
#include "params/params.hpp"

namespace heli::params {

// Length of a stored set: the format's, whatever the pages of a board.
inline constexpr std::size_t kSetBytes = 512;

// Which parameters the stored set gave.
struct Origin {
  std::uint32_t schema = 0;     // hash under which it was stored
  std::uint8_t kept = 0;        // stored values in use
  std::uint8_t dropped = 0;     // stored values that no parameter takes
  std::uint32_t fresh[3] = {};  // bit i: parameter i had no usable stored value
};

// Idle loop only, except source(). Layout of a set: README.md.
class Store {
 public:
  explicit Store(Board& board) : board_(board) {}

  // Puts the newest valid copy into `params`, or the declared defaults when there is none.
  link::ParamsSource load(Params& params);

  // Writes the older copy and reads it back; both when none is valid. May stop the processor for
  // milliseconds.
  bool save(const Params& params);

  // Source of the parameters: the result of load(), `stored` after a save. Any context.
  link::ParamsSource source() const { return source_.load(std::memory_order_relaxed); }

  const Origin& origin() const { return origin_; }

  // Idle loop, after load(): puts the default in place of a stored value that this board cannot
  // use.
  void drop(Params& params, link::Param which);

  // Counts saves over the life of the board; 0 before the first.
  std::uint32_t generation() const { return generation_; }

 private:
  Board& board_;
  std::atomic<link::ParamsSource> source_{link::ParamsSource::defaults};
  std::uint32_t generation_ = 0;
  Origin origin_;
};

}  // namespace heli::params
