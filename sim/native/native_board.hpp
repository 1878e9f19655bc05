// The flight code compiled for this machine, on a board that is memory only.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <random>
#include <string>

#include "board.hpp"
#include "byte_ring.hpp"
#include "flight_code.hpp"
#include "sim_board.hpp"

namespace heli_sim {

// What the flight code sees: heli::Board over plain memory.
class MemoryBoard final : public heli::Board {
 public:
  // The Due's numbers, so that both boards fly the same flight, duty by duty.
  static constexpr std::int16_t kDutyFull = 2100;
  static constexpr std::size_t kPageBytes = 512;
  static constexpr std::size_t kPages = 4;
  static constexpr std::size_t kFlashBytes = kPages * kPageBytes;
  using Flash = std::array<std::uint8_t, kFlashBytes>;

  MemoryBoard() { flash.fill(0xFF); }

  std::int16_t duty_full() override { return kDutyFull; }
  heli::EncoderReading read_encoders() override { return encoders; }
  void write_motors(const heli::MotorCommand& command) override { motors = command; }
  bool hardware_stop() override { return stop_input; }
  std::size_t receive(std::uint8_t* to, std::size_t most) override;
  std::size_t transmit_free() override { return tx.free(); }
  void transmit(const std::uint8_t* bytes, std::size_t count) override;
  void read_page(std::size_t page, std::uint8_t* to, std::size_t count) override;
  bool write_page(std::size_t page, const std::uint8_t* from, std::size_t count) override;
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

  // With `from_edges` the counters follow the edges, as they do on a board with registers.
  // Throws std::runtime_error when the flash file exists but cannot be read.
  // Boot ids follow from `boot_seed`.
  NativeBoard(const std::string& flash_file, bool from_edges, std::uint64_t boot_seed = 1);

  bool wants_edges() const override { return from_edges_; }
  void tick(const std::int32_t* count) override;
  MotorOutput motors() const override;
  void rest(const Edge* edges, std::size_t edge_count) override;
  void reset(heli::link::Reset cause) override;
  bool in_reset() const override { return reset_ticks_ > 0; }
  std::uint64_t boots() const override { return boots_; }
  void erase() override;
  void set_stop(bool pressed) override { memory_.stop_input = pressed; }
  void uart_receive(std::uint8_t byte) override { arriving_bytes_.push(byte); }
  bool uart_transmit(std::uint8_t& byte) override;

  MemoryBoard& memory() { return memory_; }

 private:
  void boot(heli::link::Reset cause);

  bool from_edges_;
  std::mt19937 boot_ids_;
  std::uint64_t boots_ = 0;
  bool erased_ = false;  // the flash holds no program
  MemoryBoard memory_;
  std::optional<heli::FlightCode> code_;
  std::uint32_t reset_ticks_ = 0;  // milliseconds until the reset ends
  heli::link::Reset reset_cause_ = heli::link::Reset::power_up;
  std::array<std::int32_t, heli::kAxisCount> disc_count_{};      // as of the last tick
  std::array<std::int32_t, heli::kAxisCount> count_at_reset_{};  // where the counters stood at 0
  ByteRing<64> arriving_bytes_;                                  // more than a millisecond carries
  std::size_t leaving_bytes_ = 0;  // bytes written before this millisecond
};

}  // namespace heli_sim
