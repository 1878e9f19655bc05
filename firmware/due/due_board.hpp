// The Arduino Due as the flight code sees it.
#pragma once

#include "board.hpp"

namespace heli::due {

class DueBoard final : public Board {
 public:
  explicit DueBoard(const BootReport& boot) : boot_(boot) {}

  std::int16_t duty_full() override;
  EncoderReading read_encoders() override;
  void write_motors(const MotorCommand& command) override;
  bool hardware_stop() override;
  std::size_t receive(std::uint8_t* to, std::size_t most) override;
  std::size_t transmit_free() override;
  void transmit(const std::uint8_t* bytes, std::size_t count) override;
  void read_page(std::size_t page, std::uint8_t* to, std::size_t count) override;
  bool write_page(std::size_t page, const std::uint8_t* from, std::size_t count) override;
  BootReport boot_report() override { return boot_; }

 private:
  BootReport boot_;
};

}  // namespace heli::due
