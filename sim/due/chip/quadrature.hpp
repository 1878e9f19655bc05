// The quadrature decoder of a timer counter block (section 36.6.14).
//
// Every edge counts by what it says itself, so that a reversal is right at once. The datasheet
// reports a change of DIR only after the next edge of the other phase; DIR and DIRCHG follow that.
#pragma once

#include <cstdint>

namespace due_emulator {

class Tc;

class Quadrature {
 public:
  explicit Quadrature(Tc& block) : block_(block) {}

  void reset();
  void set_mode(std::uint32_t block_mode, bool a, bool b);
  bool enabled() const { return (mode_ & (1U << 8)) != 0; }
  bool position() const { return (mode_ & (1U << 9)) != 0; }

  // Levels at the pins TIOA0 and TIOB0.
  void input(bool is_a, bool level, std::uint64_t now);
  // Lets edges through that have stood for the filter's time by now.
  void settle(std::uint64_t now);

  // QISR: IDX, DIRCHG, QERR; reading clears them.
  std::uint32_t flags() const { return flags_; }
  std::uint32_t take_flags();
  bool direction_down() const { return down_; }

 private:
  struct Input {
    bool level = false;    // behind the filter
    bool waiting = false;  // the pin differs since `since`
    std::uint64_t since = 0;
  };

  std::uint64_t filter_cycles() const;
  void pass(bool is_a, std::uint64_t time);
  void track_direction(bool is_a);

  static constexpr std::uint64_t kLongAgo = ~std::uint64_t{0};

  Tc& block_;
  std::uint32_t mode_ = 0;
  Input a_;
  Input b_;
  std::uint64_t last_edge_a_ = kLongAgo;
  std::uint64_t last_edge_b_ = kLongAgo;
  std::uint32_t flags_ = 0;
  bool down_ = false;
  bool turning_ = false;
  bool last_was_a_ = false;
  bool have_last_ = false;
};

}  // namespace due_emulator
