// The cycle of each model's next event. There are a few dozen models, for which a flat array is
// faster than a heap.
#pragma once

#include <cstdint>
#include <vector>

namespace due_emulator {

inline constexpr std::uint64_t kNever = ~std::uint64_t{0};

class EventSink {
 public:
  virtual ~EventSink() = default;
  // Called once the time given to Scheduler::set is reached; `now` may be a few cycles later.
  virtual void event(std::uint64_t now) = 0;
  // MCK changed: cycles that stand for board time are wrong now.
  virtual void clock_changed() {}
};

class Scheduler {
 public:
  using Id = std::size_t;

  // A model gets one event; set() moves it, and kNever takes it away.
  Id add(EventSink* sink) {
    sources_.push_back({kNever, sink});
    return sources_.size() - 1;
  }

  // The model's event comes at `cycle`, in place of an earlier choice.
  void set(Id id, std::uint64_t cycle) {
    const std::uint64_t before = sources_[id].cycle;
    sources_[id].cycle = cycle;
    if (cycle < next_) {
      next_ = cycle;
      // The processor runs until *deadline_; an earlier event must cut that short.
      if (deadline_ != nullptr && cycle < *deadline_) *deadline_ = cycle;
    } else if (before == next_) {
      find_next();
    }
  }

  std::uint64_t at(Id id) const { return sources_[id].cycle; }
  std::uint64_t next() const { return next_; }

  // Calls all events that are due by `now`; also those that they set for `now` or before.
  void dispatch(std::uint64_t now) {
    while (next_ <= now) {
      for (Source& source : sources_) {
        if (source.cycle > now) continue;
        source.cycle = kNever;
        source.sink->event(now);
      }
      find_next();
    }
  }

  void clock_changed() {
    for (const Source& source : sources_) source.sink->clock_changed();
  }

  // The processor runs until *deadline; an event that is set earlier moves it.
  void watch(std::uint64_t* deadline) { deadline_ = deadline; }

 private:
  struct Source {
    std::uint64_t cycle;
    EventSink* sink;
  };

  void find_next() {
    next_ = kNever;
    for (const Source& source : sources_) {
      if (source.cycle < next_) next_ = source.cycle;
    }
  }

  std::vector<Source> sources_;
  std::uint64_t next_ = kNever;
  std::uint64_t* deadline_ = nullptr;
};

}  // namespace due_emulator
