#include "due_board.hpp"

#include "encoders.hpp"
#include "flash.hpp"
#include "main.hpp"
#include "motors.hpp"
#include "uart.hpp"

namespace heli::due {
namespace {

constexpr std::size_t kJoined = 2;

}  // namespace

std::int16_t DueBoard::duty_full() { return motors::kDutyFull; }

EncoderReading DueBoard::read_encoders() { return encoders::read(); }

void DueBoard::write_motors(const MotorCommand& command) { motors::write(command); }

bool DueBoard::hardware_stop() { return motors::hardware_stop(); }

std::size_t DueBoard::receive(std::uint8_t* to, std::size_t most) {
  return uart::receive(to, most);
}

std::size_t DueBoard::transmit_free() { return uart::transmit_free(); }

void DueBoard::transmit(const std::uint8_t* bytes, std::size_t count) {
  uart::transmit(bytes, count);
}

// The parameter store's page is two of the chip's, which lie side by side.
void DueBoard::read_page(std::size_t page, std::uint8_t* to, std::size_t count) {
  flash::read_page(kJoined * page, to, count);
}

bool DueBoard::write_page(std::size_t page, const std::uint8_t* from, std::size_t count) {
  if (count > kJoined * flash::kPageBytes) return false;
  bool written = true;
  for (std::size_t part = 0; part < kJoined; ++part) {
    const std::size_t before = part * flash::kPageBytes;
    const std::size_t left = count > before ? count - before : 0;
    const std::size_t here = left < flash::kPageBytes ? left : flash::kPageBytes;
    // A first save writes four pages of 5 ms each, which is more than the watchdog should wait.
    kick_watchdog();
    written = flash::write_page(kJoined * page + part, from + before, here) && written;
  }
  return written;
}

}  // namespace heli::due
