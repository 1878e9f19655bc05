// Ring of bytes with a fixed size: the buffers between the board, the USB bridge and the host.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

namespace heli_sim {

template <std::size_t kSize>
class ByteRing {
 public:
  std::size_t size() const { return size_; }
  std::size_t free() const { return kSize - size_; }
  bool empty() const { return size_ == 0; }
  void clear() { size_ = 0; }

  // Returns false, and the byte is lost, if the ring is full.
  bool push(std::uint8_t byte) {
    if (size_ == kSize) return false;
    bytes_[(first_ + size_) % kSize] = byte;
    ++size_;
    return true;
  }

  // The oldest byte; the ring must not be empty.
  std::uint8_t pop() {
    const std::uint8_t byte = bytes_[first_];
    first_ = (first_ + 1) % kSize;
    --size_;
    return byte;
  }

 private:
  std::array<std::uint8_t, kSize> bytes_{};
  std::size_t first_ = 0;
  std::size_t size_ = 0;
};

}  // namespace heli_sim
