// A lock-free ring between one producer and one consumer, here the tick and the idle loop.
#pragma once

#include <atomic>
#include <cstddef>
#include <cstdint>

namespace heli::link {

// Positions count up for ever and are masked on use, so that full and empty need no spare slot.
// Only loads and stores: a Cortex-M3 needs no exclusive access for them.
template <class T, std::size_t kCapacity>
class Spsc {
  static_assert(kCapacity > 0 && (kCapacity & (kCapacity - 1)) == 0, "capacity: a power of two");

 public:
  // Producer. False, and nothing stored, when the ring is full.
  bool push(const T& value) {
    const std::uint32_t head = head_.load(std::memory_order_relaxed);
    if (head - tail_.load(std::memory_order_acquire) >= kCapacity) return false;
    slots_[head & kMask] = value;
    head_.store(head + 1, std::memory_order_release);
    return true;
  }

  // Producer. Where the next value may be written in place, kept by keep(); null when full.
  T* room() {
    const std::uint32_t head = head_.load(std::memory_order_relaxed);
    if (head - tail_.load(std::memory_order_acquire) >= kCapacity) return nullptr;
    return &slots_[head & kMask];
  }
  void keep() { head_.store(head_.load(std::memory_order_relaxed) + 1, std::memory_order_release); }

  // Consumer. The oldest value, valid until pop(); null when empty.
  const T* front() const {
    const std::uint32_t tail = tail_.load(std::memory_order_relaxed);
    if (head_.load(std::memory_order_acquire) == tail) return nullptr;
    return &slots_[tail & kMask];
  }

  // Consumer. Gives the slot of front() back.
  void pop() { tail_.store(tail_.load(std::memory_order_relaxed) + 1, std::memory_order_release); }

  // Consumer. At least this many values wait.
  std::size_t size() const {
    return head_.load(std::memory_order_acquire) - tail_.load(std::memory_order_relaxed);
  }

 private:
  static constexpr std::uint32_t kMask = kCapacity - 1;

  std::atomic<std::uint32_t> head_{0};
  std::atomic<std::uint32_t> tail_{0};
  T slots_[kCapacity];
};

}  // namespace heli::link
