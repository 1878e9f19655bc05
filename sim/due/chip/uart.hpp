// UART and its peripheral DMA controller (sections 34 and 26).
#pragma once

#include "chip/peripheral.hpp"
#include "chip/pins.hpp"

namespace due_emulator {

// UART_MR.PAR
enum class Parity : std::uint8_t { kEven = 0, kOdd = 1, kSpace = 2, kMark = 3, kNone = 4 };

// The other end of the wire: eight data bits and one stop bit, as here.
class SerialPeer {
 public:
  virtual ~SerialPeer() = default;
  virtual Parity parity() const { return Parity::kNone; }
  // A byte that the UART has sent, at the end of its stop bit; `bit_cycles` is the sender's bit.
  virtual void byte_from_uart(std::uint8_t byte, std::uint32_t bit_cycles, std::uint64_t now) = 0;
};

// One direction of a PDC: a running buffer and the next one.
struct PdcHalf {
  std::uint32_t pointer = 0;
  std::uint32_t count = 0;
  std::uint32_t next_pointer = 0;
  std::uint32_t next_count = 0;
  bool enabled = false;
  bool ended = true;  // ENDRX, ENDTX

  bool ready() const { return enabled && count != 0; }
  bool empty() const { return count == 0 && next_count == 0; }
  // One byte was moved.
  void advance();
  void set_count(std::uint32_t value);
  void set_next_count(std::uint32_t value);
};

class Uart final : public Peripheral, public PinDriver {
 public:
  Uart(System& system, Pins& pins);

  void set_peer(SerialPeer* peer) { peer_ = peer; }
  void reset() override;
  void event(std::uint64_t now) override;

  // A byte arrives from the wire, at the middle of its stop bit, sent with bits of `bit_cycles`.
  void receive(std::uint8_t byte, std::uint64_t bit_cycles);

  bool drives(int signal) const override { return signal == 1; }
  bool level(int) const override { return true; }  // idle line; bits are not modelled one by one

  std::uint32_t bit_cycles() const { return 16 * (divider_ & 0xFFFFU); }
  std::uint64_t overruns() const { return overruns_; }
  // Bytes that the program has handed over and whose stop bit has not ended.
  std::uint32_t unsent() const {
    return tx_.count + tx_.next_count + (shifting_ ? 1U : 0U) + (holding_full_ ? 1U : 0U);
  }

 protected:
  std::uint32_t read(std::uint32_t offset) override;
  std::uint32_t from_outside(std::uint32_t offset) const override;
  void write(std::uint32_t offset, std::uint32_t value) override;

 private:
  std::uint32_t status() const;
  std::uint64_t frame_cycles() const;
  // 4 to 7 all mean none.
  Parity parity() const {
    return static_cast<Parity>(((mode_ >> 9) & 7U) < 4 ? (mode_ >> 9) & 7U : 4U);
  }
  bool has_parity() const { return parity() != Parity::kNone; }
  // Whether both ends use the same parity.
  bool understood() const { return peer_ == nullptr || peer_->parity() == parity(); }
  void control(std::uint32_t value);
  void transmit(std::uint8_t byte);
  void begin_shift(std::uint8_t byte, std::uint64_t from);
  void feed_transmitter();
  void drain_receiver();
  std::uint32_t read_pdc(std::uint32_t offset) const;
  void write_pdc(std::uint32_t offset, std::uint32_t value);
  void check_pdc(std::uint32_t offset, std::uint32_t value) const;
  void update_irq();

  Pins& pins_;
  SerialPeer* peer_ = nullptr;
  Scheduler::Id id_;
  std::uint32_t mode_ = 0;        // UART_MR
  std::uint32_t interrupts_ = 0;  // UART_IMR
  std::uint32_t divider_ = 0;     // UART_BRGR.CD
  bool rx_enabled_ = false;
  bool tx_enabled_ = false;
  bool rx_ready_ = false;
  std::uint8_t rx_byte_ = 0;  // UART_RHR
  std::uint32_t errors_ = 0;  // UART_SR: OVRE, FRAME, PARE
  bool shifting_ = false;     // a byte is being sent:
  std::uint8_t shift_byte_ = 0;
  std::uint64_t shift_end_ = 0;  // cycle at which its stop bit ends
  bool holding_full_ = false;    // UART_THR holds the byte after it
  std::uint8_t holding_ = 0;
  PdcHalf rx_;
  PdcHalf tx_;
  std::uint64_t overruns_ = 0;
};

}  // namespace due_emulator
