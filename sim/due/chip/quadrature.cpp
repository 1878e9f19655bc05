// Filter, direction and errors of the quadrature decoder; see quadrature.hpp.
#include "chip/quadrature.hpp"

#include <algorithm>
#include <utility>

#include "chip/tc.hpp"

namespace due_emulator {

namespace {

// TC_BMR
constexpr std::uint32_t kTransparent = 1U << 11;  // QDTRANS: the direction is not tracked
constexpr std::uint32_t kBothEdges = 1U << 12;    // EDGPHA
constexpr std::uint32_t kInvertA = 1U << 13;
constexpr std::uint32_t kInvertB = 1U << 14;
constexpr std::uint32_t kSwap = 1U << 16;
constexpr std::uint32_t kFilter = 1U << 19;
constexpr Field kMaxFilt{20, 6};

// TC_QISR
constexpr std::uint32_t kDirChange = 1U << 1;
constexpr std::uint32_t kError = 1U << 2;

}  // namespace

void Quadrature::reset() {
  mode_ = flags_ = 0;
  a_ = b_ = {};
  last_edge_a_ = last_edge_b_ = kLongAgo;
  down_ = turning_ = have_last_ = false;
}

// TC_BMR was written; the decoder begins anew from the levels `a` and `b` at TIOA0 and TIOB0.
void Quadrature::set_mode(std::uint32_t block_mode, bool a, bool b) {
  mode_ = block_mode;
  a_ = {(mode_ & kInvertA) != 0 ? !a : a, false, 0};
  b_ = {(mode_ & kInvertB) != 0 ? !b : b, false, 0};
  if ((mode_ & kSwap) != 0) std::swap(a_, b_);
  last_edge_a_ = last_edge_b_ = kLongAgo;
  have_last_ = turning_ = false;
}

// Cycles by which the filter delays an edge; 0 without filter. Pulses of up to MAXFILT clocks are
// dropped.
std::uint64_t Quadrature::filter_cycles() const {
  return (mode_ & kFilter) != 0 ? kMaxFilt.of(mode_) + 1 : 0;
}

// An edge at a pin. After inversion and swap it waits for the filter's time; a pulse that ends
// before that is dropped.
void Quadrature::input(bool is_a, bool level, std::uint64_t now) {
  if (!enabled()) return;
  settle(now);
  if ((mode_ & (is_a ? kInvertA : kInvertB)) != 0) level = !level;
  if ((mode_ & kSwap) != 0) is_a = !is_a;
  Input& phase = is_a ? a_ : b_;
  phase.waiting = level != phase.level;
  phase.since = now;
  if (filter_cycles() == 0) settle(now);
}

// See quadrature.hpp: lets each waiting edge pass that is older than the filter's time.
void Quadrature::settle(std::uint64_t now) {
  const std::uint64_t wait = filter_cycles();
  const auto ready = [now, wait](const Input& phase) {
    return phase.waiting && now >= phase.since + wait;
  };
  // Both phases are delayed alike, so the older edge comes out first.
  const bool a_first = a_.since <= b_.since;
  for (const bool is_a : {a_first, !a_first}) {
    const Input& phase = is_a ? a_ : b_;
    if (ready(phase)) pass(is_a, phase.since);
  }
}

// An edge has passed the filter: it may be an error (QERR), and it may count: edges of phase B only
// with EDGPHA. `up` follows from the levels of both phases after the edge.
void Quadrature::pass(bool is_a, std::uint64_t time) {
  Input& phase = is_a ? a_ : b_;
  phase.waiting = false;
  phase.level = !phase.level;
  (is_a ? last_edge_a_ : last_edge_b_) = time;
  const std::uint64_t other = is_a ? last_edge_b_ : last_edge_a_;
  // Edges of the two phases closer than the filter's time cannot come from a sensor in order.
  if (other != kLongAgo && time - other < std::max<std::uint64_t>(filter_cycles(), 1)) {
    flags_ |= kError;
  }
  if ((mode_ & kTransparent) == 0) track_direction(is_a);
  if (!is_a && (mode_ & kBothEdges) == 0) return;
  const bool up = is_a ? a_.level != b_.level : a_.level == b_.level;
  block_.quadrature_step(up ? 1 : -1);
}

// Two edges in a row on one phase announce a turn, an edge of the other phase confirms it.
void Quadrature::track_direction(bool is_a) {
  const bool up = is_a ? a_.level != b_.level : a_.level == b_.level;
  if (have_last_ && last_was_a_ == is_a) turning_ = true;
  if (turning_ && last_was_a_ != is_a && up == down_) {
    down_ = !up;
    flags_ |= kDirChange;
  } else if (!have_last_) {
    down_ = !up;
  }
  if (have_last_ && last_was_a_ != is_a) turning_ = false;
  last_was_a_ = is_a;
  have_last_ = true;
}

std::uint32_t Quadrature::take_flags() { return std::exchange(flags_, 0U); }

}  // namespace due_emulator
