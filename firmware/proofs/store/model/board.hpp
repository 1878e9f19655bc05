// A board that is only its two pages of flash. The power may be cut at any write.
#pragma once

#include <cstddef>
#include <cstdint>

namespace heli {

struct Page {
  std::uint8_t bytes[24];
};

class Board {
 public:
  void read_page(std::size_t page, std::uint8_t* to, std::size_t count);
  bool write_page(std::size_t page, const std::uint8_t* from, std::size_t count);

  Page first_;
  Page second_;
  bool cut_ = false;  // then the processor does nothing any more
};

}  // namespace heli
