// Transmitter, receiver, PDC (peripheral DMA) and registers of the UART; see uart.hpp.
#include "chip/uart.hpp"

#include <algorithm>

namespace due_emulator {

namespace {

using access::kBoth;
using access::kRead;
using access::kWrite;

constexpr Register kRegisters[] = {
    {0x000, "UART_CR", kWrite},  {0x004, "UART_MR", kBoth},   {0x008, "UART_IER", kWrite},
    {0x00C, "UART_IDR", kWrite}, {0x010, "UART_IMR", kRead},  {0x014, "UART_SR", kRead},
    {0x018, "UART_RHR", kRead},  {0x01C, "UART_THR", kWrite}, {0x020, "UART_BRGR", kBoth},
    {0x100, "UART_RPR", kBoth},  {0x104, "UART_RCR", kBoth},  {0x108, "UART_TPR", kBoth},
    {0x10C, "UART_TCR", kBoth},  {0x110, "UART_RNPR", kBoth}, {0x114, "UART_RNCR", kBoth},
    {0x118, "UART_TNPR", kBoth}, {0x11C, "UART_TNCR", kBoth}, {0x120, "UART_PTCR", kWrite},
    {0x124, "UART_PTSR", kRead},
};

// Offsets of the registers that the code below names.
constexpr std::uint32_t kCr = 0x00;
constexpr std::uint32_t kMr = 0x04;
constexpr std::uint32_t kIer = 0x08;
constexpr std::uint32_t kIdr = 0x0C;
constexpr std::uint32_t kImr = 0x10;
constexpr std::uint32_t kSr = 0x14;
constexpr std::uint32_t kRhr = 0x18;
constexpr std::uint32_t kThr = 0x1C;
constexpr std::uint32_t kBrgr = 0x20;
constexpr std::uint32_t kRpr = 0x100;
constexpr std::uint32_t kRcr = 0x104;
constexpr std::uint32_t kTpr = 0x108;
constexpr std::uint32_t kTcr = 0x10C;
constexpr std::uint32_t kRnpr = 0x110;
constexpr std::uint32_t kRncr = 0x114;
constexpr std::uint32_t kTnpr = 0x118;
constexpr std::uint32_t kTncr = 0x11C;
constexpr std::uint32_t kPtcr = 0x120;

// UART_CR
constexpr std::uint32_t kRstRx = 1U << 2;
constexpr std::uint32_t kRstTx = 1U << 3;
constexpr std::uint32_t kRxEn = 1U << 4;
constexpr std::uint32_t kRxDis = 1U << 5;
constexpr std::uint32_t kTxEn = 1U << 6;
constexpr std::uint32_t kTxDis = 1U << 7;
constexpr std::uint32_t kRstSta = 1U << 8;

// UART_SR
constexpr std::uint32_t kRxRdy = 1U << 0;
constexpr std::uint32_t kTxRdy = 1U << 1;
constexpr std::uint32_t kEndRx = 1U << 3;
constexpr std::uint32_t kEndTx = 1U << 4;
constexpr std::uint32_t kOvre = 1U << 5;
constexpr std::uint32_t kFrame = 1U << 6;
constexpr std::uint32_t kPare = 1U << 7;
constexpr std::uint32_t kTxEmpty = 1U << 9;
constexpr std::uint32_t kTxBufE = 1U << 11;
constexpr std::uint32_t kRxBufF = 1U << 12;

constexpr Field kChannelMode{14, 2};  // UART_MR.CHMODE
constexpr std::uint32_t kLocalLoopback = 2;
constexpr std::uint32_t kMrMask = 0xCE00;  // UART_MR: CHMODE, PAR

constexpr int kTxPin = pin_of('A', 9);
// Relative difference of the bit rates that the receiver tolerates: half a bit less the start bit's
// uncertainty of a sixteenth, over the 9.5 bits to the middle of the stop bit.
constexpr double kLargestMismatch = 0.045;

// Returns a wrong value for a byte that the receiver cannot decode. Any wrong value is right here.
std::uint8_t garbled(std::uint8_t byte) { return static_cast<std::uint8_t>(byte ^ 0x5AU); }

}  // namespace

// At the end of the running buffer ENDRX or ENDTX is set, and the next buffer becomes the running
// one.
void PdcHalf::advance() {
  ++pointer;
  if (--count != 0) return;
  ended = true;
  pointer = next_count != 0 ? next_pointer : pointer;
  count = next_count;
  next_count = 0;
}

void PdcHalf::set_count(std::uint32_t value) {
  count = value & 0xFFFFU;
  if (count != 0) ended = false;
}

// If the running buffer is used up, the next one starts immediately.
void PdcHalf::set_next_count(std::uint32_t value) {
  next_count = value & 0xFFFFU;
  if (next_count == 0) return;
  ended = false;
  if (count == 0) {
    pointer = next_pointer;
    count = next_count;
    next_count = 0;
  }
}

Uart::Uart(System& system, Pins& pins)
    : Peripheral(system, "UART", 0x400E0800, 0x130, id::kUart, kRegisters),
      pins_(pins),
      id_(system.scheduler.add(this)) {
  pins.connect_driver(kTxPin, false, this, 1);
}

// Transmitter and receiver are off, and all buffers are empty.
void Uart::reset() {
  mode_ = interrupts_ = divider_ = errors_ = 0;
  rx_enabled_ = tx_enabled_ = rx_ready_ = shifting_ = holding_full_ = false;
  rx_byte_ = 0;
  rx_ = {};
  tx_ = {};
  system_.scheduler.set(id_, kNever);
  update_irq();
}

// UART_SR as it is now.
std::uint32_t Uart::status() const {
  std::uint32_t value = errors_;
  if (rx_ready_) value |= kRxRdy;
  if (tx_enabled_ && !holding_full_) value |= kTxRdy;
  if (tx_enabled_ && !holding_full_ && !shifting_) value |= kTxEmpty;
  if (rx_.ended) value |= kEndRx;
  if (tx_.ended) value |= kEndTx;
  if (rx_.empty()) value |= kRxBufF;
  if (tx_.empty()) value |= kTxBufE;
  return value;
}

void Uart::update_irq() { system_.set_irq(id::kUart, (status() & interrupts_) != 0); }

// Start bit, eight data bits, parity if any, one stop bit.
std::uint64_t Uart::frame_cycles() const {
  return std::uint64_t{bit_cycles()} * (has_parity() ? 11U : 10U);
}

// -- transmitter ------------------------------------------------------------------------------

// Sends a byte from the cycle `from` on; event() is its end.
void Uart::begin_shift(std::uint8_t byte, std::uint64_t from) {
  shifting_ = true;
  shift_byte_ = byte;
  shift_end_ = from + frame_cycles();
  system_.scheduler.set(id_, shift_end_);
}

// UART_THR: the byte goes to the shift register, or waits in the holding register.
void Uart::transmit(std::uint8_t byte) {
  if (divider_ == 0) return misuse(kThr, "a byte is sent while BRGR.CD is 0");
  if (!shifting_) return begin_shift(byte, system_.now());
  holding_ = byte;
  holding_full_ = true;
}

// Moves bytes from the PDC's buffer to the transmitter while that has room.
void Uart::feed_transmitter() {
  while (tx_enabled_ && tx_.ready() && !holding_full_) {
    std::uint8_t byte = 0;
    if (!system_.bus.dma_read(tx_.pointer, byte)) {
      misuse(kTpr, "the PDC reads from " + hex(tx_.pointer) + ", where there is no memory");
      tx_.enabled = false;
      return;
    }
    tx_.advance();
    transmit(byte);
  }
}

// The end of a byte: the next one begins, then the peer (or the local loopback) gets this one.
void Uart::event(std::uint64_t) {
  if (!shifting_) return;
  const std::uint64_t end = shift_end_;
  const std::uint8_t byte = shift_byte_;
  shifting_ = false;
  if (holding_full_) {
    holding_full_ = false;
    begin_shift(holding_, end);
  }
  feed_transmitter();
  update_irq();
  const std::uint32_t channel_mode = kChannelMode.of(mode_);
  if (channel_mode == kLocalLoopback) return receive(byte, bit_cycles());
  const PinSetting& pin = pins_.setting(kTxPin);
  if (!pin.given_to_peripheral || pin.peripheral_b) {
    return misuse(kThr, "a byte is sent while PA9 is not given to the UART (PIO_PDR, PIO_ABSR)");
  }
  if (peer_ == nullptr) return;
  peer_->byte_from_uart(understood() ? byte : garbled(byte), bit_cycles(), end);
}

// -- receiver ---------------------------------------------------------------------------------

// Puts a byte from the wire into UART_RHR. With another bit rate or parity at the sender the byte
// is wrong and FRAME (and PARE) is set; a byte that was not read is lost, which sets OVRE.
void Uart::receive(std::uint8_t byte, std::uint64_t sender_bit_cycles) {
  if (!rx_enabled_ || divider_ == 0 || !system_.clocked(clock_id_)) return;
  const double ratio = static_cast<double>(sender_bit_cycles) / bit_cycles();
  const bool in_step = ratio >= 1.0 - kLargestMismatch && ratio <= 1.0 + kLargestMismatch;
  // With different parities, a parity bit is read as a stop bit, and the next start bit is expected
  // at the wrong time. The local loopback has only one end.
  const bool same_frame = kChannelMode.of(mode_) != 0 || understood();
  if (!in_step || !same_frame) {
    errors_ |= same_frame ? kFrame : kFrame | kPare;
    byte = garbled(byte);
  }
  if (rx_ready_) {
    errors_ |= kOvre;
    ++overruns_;
  }
  rx_byte_ = byte;
  rx_ready_ = true;
  drain_receiver();
  update_irq();
}

// Moves the received byte to the PDC's buffer, if there is one.
void Uart::drain_receiver() {
  if (!rx_ready_ || !rx_.ready()) return;
  if (!system_.bus.dma_write(rx_.pointer, rx_byte_)) {
    misuse(kRpr, "the PDC writes to " + hex(rx_.pointer) + ", where there is no SRAM");
    rx_.enabled = false;
    return;
  }
  rx_ready_ = false;
  rx_.advance();
}

// -- registers --------------------------------------------------------------------------------

// UART_CR: bits 2 to 8 are RSTRX, RSTTX, RXEN, RXDIS, TXEN, TXDIS, RSTSTA.
void Uart::control(std::uint32_t value) {
  if ((value & kRstRx) != 0) rx_enabled_ = rx_ready_ = false;
  if ((value & kRstTx) != 0) {
    tx_enabled_ = shifting_ = holding_full_ = false;
    system_.scheduler.set(id_, kNever);
  }
  if ((value & kRxEn) != 0) rx_enabled_ = true;
  if ((value & kRxDis) != 0) rx_enabled_ = false;
  if ((value & kTxEn) != 0) tx_enabled_ = true;
  if ((value & kTxDis) != 0) tx_enabled_ = false;
  if ((value & kRstSta) != 0) errors_ = 0;
  feed_transmitter();
}

// Registers of the PDC. UART_PTSR (default): bit 0 is RXTEN, bit 8 TXTEN.
std::uint32_t Uart::read_pdc(std::uint32_t offset) const {
  switch (offset) {
    case kRpr:
      return rx_.pointer;
    case kRcr:
      return rx_.count;
    case kTpr:
      return tx_.pointer;
    case kTcr:
      return tx_.count;
    case kRnpr:
      return rx_.next_pointer;
    case kRncr:
      return rx_.next_count;
    case kTnpr:
      return tx_.next_pointer;
    case kTncr:
      return tx_.next_count;
    default:
      return (rx_.enabled ? 1U : 0U) | (tx_.enabled ? 1U << 8 : 0U);
  }
}

// The datasheet does not say what happens when a buffer is written just as the running one ends, so
// that is reported as misuse.
void Uart::check_pdc(std::uint32_t offset, std::uint32_t value) const {
  // Offsets of the transmitter's registers have bit 3 set.
  const PdcHalf& half = (offset & 8U) != 0 ? tx_ : rx_;
  if (!half.enabled) return;
  const bool next = offset >= kRnpr;
  if (!next && half.count != 0) misuse(offset, "write while the PDC moves the running buffer");
  if (next && half.count == 1 && value != 0) {
    misuse(offset, "write while the PDC moves the last byte of the running buffer");
  }
}

// Registers of the PDC. UART_PTCR (default): bits 0, 1, 8, 9 are RXTEN, RXTDIS, TXTEN, TXTDIS.
void Uart::write_pdc(std::uint32_t offset, std::uint32_t value) {
  if (offset < kPtcr) check_pdc(offset, value);
  switch (offset) {
    case kRpr:
      rx_.pointer = value;
      break;
    case kRcr:
      rx_.set_count(value);
      break;
    case kTpr:
      tx_.pointer = value;
      break;
    case kTcr:
      tx_.set_count(value);
      break;
    case kRnpr:
      rx_.next_pointer = value;
      break;
    case kRncr:
      rx_.set_next_count(value);
      break;
    case kTnpr:
      tx_.next_pointer = value;
      break;
    case kTncr:
      tx_.set_next_count(value);
      break;
    default:
      // UART_PTCR: RXTEN, RXTDIS, TXTEN, TXTDIS.
      if ((value & (1U << 0)) != 0) rx_.enabled = true;
      if ((value & (1U << 1)) != 0) rx_.enabled = false;
      if ((value & (1U << 8)) != 0) tx_.enabled = true;
      if ((value & (1U << 9)) != 0) tx_.enabled = false;
      break;
  }
  drain_receiver();
  feed_transmitter();
}

// Bits that depend on what the peer sends: to wait for them is no mistake.
std::uint32_t Uart::from_outside(std::uint32_t offset) const {
  if (offset == kSr) return kRxRdy | kEndRx | kRxBufF | kOvre | kFrame | kPare;
  return offset == kRhr || offset == kRpr || offset == kRcr ? ~0U : 0;
}

// Reading UART_RHR clears RXRDY.
std::uint32_t Uart::read(std::uint32_t offset) {
  if (offset >= kRpr) return read_pdc(offset);
  switch (offset) {
    case kMr:
      return mode_;
    case kImr:
      return interrupts_;
    case kSr:
      return status();
    case kRhr:
      rx_ready_ = false;
      update_irq();
      return rx_byte_;
    case kBrgr:
      return divider_;
    default:
      return 0;
  }
}

// Each write can change the status, and so the interrupt line.
void Uart::write(std::uint32_t offset, std::uint32_t value) {
  switch (offset) {
    case kCr:
      control(value);
      break;
    case kMr:
      mode_ = value & kMrMask;
      // Automatic echo and remote loopback.
      if (has_bit(kChannelMode.of(value), 0))
        not_modelled(offset, "this channel mode is not modelled");
      break;
    case kIer:
      interrupts_ |= value;
      break;
    case kIdr:
      interrupts_ &= ~value;
      break;
    case kThr:
      if ((status() & kTxRdy) == 0) {
        misuse(offset, "write while UART_SR.TXRDY is 0: a byte is lost");
      }
      transmit(static_cast<std::uint8_t>(value));
      break;
    case kBrgr:
      divider_ = value & 0xFFFFU;
      break;
    default:
      write_pdc(offset, value);
      break;
  }
  update_irq();
}

}  // namespace due_emulator
