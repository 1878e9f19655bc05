// A board that only says what it knows of its last start.
#pragma once

#include <cstddef>
#include <cstdint>

namespace heli {

inline constexpr std::size_t kAxisCount = 3;

struct BootReport {
  std::uint8_t board;
  std::uint8_t reset;
  std::uint8_t boot_fault;
  std::uint32_t boot_id;
};

class Board {
 public:
  BootReport boot_report();
};

}  // namespace heli
