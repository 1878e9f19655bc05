// A board whose every input and number a test decides.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <optional>
#include <stdexcept>
#include <vector>

#include "board.hpp"

namespace heli_test {

// Its flash erases a page byte by byte and then writes it byte by byte; power may fail at any of
// these steps, after which nothing more changes.
class HarnessBoard final : public heli::Board {
 public:
  static constexpr std::size_t kPages = 2;

  HarnessBoard(std::int16_t duty_full, std::size_t page_bytes)
      : flash(kPages * page_bytes, 0xff), duty_full_(duty_full), page_bytes_(page_bytes) {}

  std::int16_t duty_full() override { return duty_full_; }
  heli::EncoderReading read_encoders() override { return encoders; }
  void write_motors(const heli::MotorCommand& command) override { motors = command; }
  bool hardware_stop() override { return stop_input; }

  std::size_t receive(std::uint8_t* to, std::size_t most) override {
    const std::size_t count = std::min(most, received.size());
    std::copy_n(received.begin(), count, to);
    received.erase(received.begin(), received.begin() + static_cast<std::ptrdiff_t>(count));
    return count;
  }
  std::size_t transmit_free() override { return room; }
  void transmit(const std::uint8_t* bytes, std::size_t count) override {
    if (count > room) throw std::logic_error("more bytes sent than transmit_free() allowed");
    sent.insert(sent.end(), bytes, bytes + count);
    room -= count;
  }

  void read_page(std::size_t page, std::uint8_t* to, std::size_t count) override {
    if (count > page_bytes_) throw std::logic_error("more read than a page has");
    std::copy_n(page_at(page), count, to);
  }
  bool write_page(std::size_t page, const std::uint8_t* from, std::size_t count) override {
    if (count > page_bytes_) return false;
    for (std::size_t i = 0; i < page_bytes_; ++i) step(page_at(page)[i], 0xff);
    for (std::size_t i = 0; i < count; ++i) step(page_at(page)[i], from[i]);
    return true;
  }

  heli::BootReport boot_report() override { return {}; }

  heli::EncoderReading encoders{};
  heli::MotorCommand motors{};
  bool stop_input = false;
  std::vector<std::uint8_t> flash;
  std::deque<std::uint8_t> received;
  std::vector<std::uint8_t> sent;
  std::size_t room = 4096;
  std::optional<std::size_t> steps_left;

 private:
  std::uint8_t* page_at(std::size_t page) { return flash.data() + page * page_bytes_; }

  void step(std::uint8_t& byte, std::uint8_t value) {
    if (steps_left == 0U) return;
    if (steps_left) --*steps_left;
    byte = value;
  }

  std::int16_t duty_full_;
  std::size_t page_bytes_;
};

}  // namespace heli_test
