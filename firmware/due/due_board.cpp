#include "due_board.hpp"

#include "encoders.hpp"
#include "flash.hpp"
#include "motors.hpp"
#include "uart.hpp"

namespace heli::due {

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

void DueBoard::read_page(std::size_t page, std::uint8_t* to, std::size_t count) {
  flash::read_page(page, to, count);
}

bool DueBoard::write_page(std::size_t page, const std::uint8_t* from, std::size_t count) {
  return flash::write_page(page, from, count);
}

}  // namespace heli::due
