// The flight code compiled for this machine, on a board that is memory only.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>

#include "board.hpp"
#include "byte_ring.hpp"
#include "core.hpp"
#include "sim_board.hpp"

namespace heli_sim {

// What the flight code sees: heli::Board over plain memory.
class MemoryBoard final : public heli::Board {
 public:
  static constexpr std::size_t kPages = 4;
  static constexpr std::size_t kFlashBytes = kPages * kPageBytes;
  using Flash = std::array<std::uint8_t, kFlashBytes>;

  MemoryBoard() { flash.fill(0xFF); }

  heli::EncoderReading read_encoders() override { return encoders; }
  void write_motors(const heli::MotorCommand& command) override { motors = command; }
  bool hardware_stop() override { return stop_input; }
  std::size_t receive(std::uint8_t* to, std::size_t most) override;
  std::size_t transmit_free() override { return tx.free(); }
  void transmit(const std::uint8_t* bytes, std::size_t count) override;
  void read_page(std::size_t page, std::uint8_t* to) override;
  bool write_page(std::size_t page, const std::uint8_t* from) override;
  heli::BootReport boot_report() override { return boot; }

  heli::EncoderReading encoders{};
  heli::MotorCommand motors{};
  heli::BootReport boot{};
  bool stop_input = false;
  Flash flash;
  // Empty: the flash is lost with the process.
  std::string flash_file;
  ByteRing<1024> rx;
  ByteRing<2048> tx;
  std::uint64_t rx_overflow = 0;
};

class NativeBoard final : public SimBoard {
 public:
  // The 16U2 holds the reset line for about 205 ms when the port is opened.
  static constexpr std::uint32_t kResetTicks = 205;

  // With `from_edges` the counters are this board's own and follow the edges, as they do on a
  // board with registers; the tick then comes at the end of its millisecond.
  // Throws std::runtime_error when the flash file exists but cannot be read.
  NativeBoard(const std::string& flash_file, bool from_edges);

  bool wants_edges() const override { return from_edges_; }
  void run(const EncoderInput& encoders) override;
  MotorOutput motors() const override;
  void reset(heli::link::Reset cause) override;
  void uart_receive(std::uint8_t byte) override;
  bool uart_transmit(std::uint8_t& byte) override;

  MemoryBoard& memory() { return memory_; }
  bool in_reset() const { return reset_ticks_ > 0; }

 private:
  void boot(heli::link::Reset cause);
  void count(const EncoderInput& encoders);

  bool from_edges_;
  MemoryBoard memory_;
  std::optional<heli::Core> core_;
  std::uint32_t reset_ticks_ = 0;
  heli::link::Reset cause_ = heli::link::Reset::power_up;
};

}  // namespace heli_sim
