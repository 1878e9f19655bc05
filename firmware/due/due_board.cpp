// The functions of Board, passed on to the drivers of this folder.
#include "due_board.hpp"

#include "drivers.hpp"
#include "motors.hpp"

namespace heli::due {
namespace {

// A page of the Board has two of the chip's pages, because a parameter set has 512 bytes.
constexpr std::size_t kChipPagesPerPage = 2;

}  // namespace

std::int16_t DueBoard::duty_full() { return motors::kDutyFull; }

EncoderReading DueBoard::read_encoders() { return encoders::read(); }

void DueBoard::write_motors(const MotorCommand& command) { motors::write(command); }

bool DueBoard::hardware_stop() { return motors::hardware_stop(); }

std::size_t DueBoard::receive(std::uint8_t* to, std::size_t capacity) {
  return uart::receive(to, capacity);
}

std::size_t DueBoard::transmit_free() { return uart::transmit_free(); }

void DueBoard::transmit(const std::uint8_t* bytes, std::size_t count) {
  uart::transmit(bytes, count);
}

// The chip's pages of one Board page are neighbours.
void DueBoard::read_page(std::size_t page, std::uint8_t* to, std::size_t count) {
  flash::read_page(kChipPagesPerPage * page, to, count);
}

bool DueBoard::write_page(std::size_t page, const std::uint8_t* from, std::size_t count) {
  if (count > kChipPagesPerPage * flash::kPageBytes) return false;
  bool written = true;
  for (std::size_t part = 0; part < kChipPagesPerPage; ++part) {
    const std::size_t offset = part * flash::kPageBytes;
    const std::size_t remaining = count > offset ? count - offset : 0;
    const std::size_t part_count = remaining < flash::kPageBytes ? remaining : flash::kPageBytes;
    // A first save writes four pages of 5 ms each, which is more than the watchdog should wait.
    kick_watchdog();
    written =
        flash::write_page(kChipPagesPerPage * page + part, from + offset, part_count) && written;
  }
  return written;
}

}  // namespace heli::due
