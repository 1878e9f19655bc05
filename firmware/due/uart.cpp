// Two rings that the PDC (the chip's peripheral DMA) fills and empties; see uart.hpp. Idle loop.
#include <cstring>

#include "cortex_m3.hpp"
#include "drivers.hpp"
#include "link/declaration.hpp"
#include "pins.hpp"
#include "registers.hpp"

namespace heli::due::uart {
namespace {

constexpr std::uint32_t kDivider = clock::kMck_Hz / (16 * link::kBaud);
static_assert(kDivider * 16 * link::kBaud == clock::kMck_Hz, "the baud rate must be exact");

// The PDC fills one half while the other waits as its next buffer: 512 bytes are 20 ms.
constexpr std::uint32_t kReceiveHalf = 512;
constexpr std::uint32_t kReceiveBytes = 2 * kReceiveHalf;
constexpr std::uint32_t kTransmitBytes = 2048;

std::uint8_t receive_ring[kReceiveBytes];
std::uint8_t transmit_ring[kTransmitBytes];

// Positions count all bytes since the start and are masked on use.
std::uint32_t received;      // up to the last reading of the PDC
std::uint32_t fetched;       // up to here receive() has returned bytes
std::uint32_t offered;       // up to here the PDC may fill the ring
std::uint32_t queued;        // up to here transmit() has filled the ring
std::uint32_t given_to_pdc;  // up to here the PDC has been told to send

std::uint32_t address_of(const std::uint8_t* byte) {
  return static_cast<std::uint32_t>(reinterpret_cast<std::uintptr_t>(byte));
}

// Gives the PDC a buffer; false if it cannot take one now. The datasheet does not say what happens
// when the next buffer is written just as the present one ends. So it is written only while at
// least two bytes remain: with three bytes and interrupts masked, at most one byte of 40 us can be
// moved between reading the counter and writing the next buffer.
bool give_buffer(ReadWrite& pointer, ReadWrite& counter, ReadWrite& next_pointer,
                 ReadWrite& next_counter, const std::uint8_t* bytes, std::uint32_t count) {
  if (next_counter.read() != 0U) return false;
  mask_interrupts();
  const std::uint32_t remaining = counter.read();
  const bool can_chain = remaining > 2U;
  if (can_chain) {
    next_pointer.write(address_of(bytes));
    next_counter.write(count);
  } else if (remaining == 0U) {
    pointer.write(address_of(bytes));
    counter.write(count);
  }
  unmask_interrupts();
  return can_chain || remaining == 0U;
}

// Bytes that the PDC has yet to move, of the present and the next buffer.
std::uint32_t bytes_to_move(const ReadWrite& counter, const ReadWrite& next_counter) {
  std::uint32_t next = 0;
  std::uint32_t present = 0;
  do {
    next = next_counter.read();
    present = counter.read();
  } while (next != next_counter.read());
  return next + present;
}

// Updates `received`, and gives the PDC the next half of the ring.
void service_receiver() {
  // By the counters: the pointer would be the same in a full ring and in an empty one.
  received = offered - bytes_to_move(UART->UART_RCR, UART->UART_RNCR);
  // A half is offered again only when all of it has been fetched. If receive() is not called, the
  // receiver stops; it never overwrites older bytes.
  if (offered - fetched > kReceiveHalf) return;
  if (give_buffer(UART->UART_RPR, UART->UART_RCR, UART->UART_RNPR, UART->UART_RNCR,
                  receive_ring + offered % kReceiveBytes, kReceiveHalf)) {
    offered += kReceiveHalf;
  }
}

// Gives the PDC what is queued, up to the end of the ring.
void service_transmitter() {
  const std::uint32_t available = queued - given_to_pdc;
  if (available == 0U) return;
  const std::uint32_t start = given_to_pdc % kTransmitBytes;
  const std::uint32_t until_ring_end = kTransmitBytes - start;
  const std::uint32_t count = available < until_ring_end ? available : until_ring_end;
  if (give_buffer(UART->UART_TPR, UART->UART_TCR, UART->UART_TNPR, UART->UART_TNCR,
                  transmit_ring + start, count)) {
    given_to_pdc += count;
  }
}

}  // namespace

void start() {
  PMC->PMC_PCER0.write(bit(ID_UART));
  pins::to_peripheral_a(PIOA, pins::kReceive.mask() | pins::kTransmit.mask());
  UART->UART_CR.write(UART_CR_RSTRX | UART_CR_RSTTX | UART_CR_RSTSTA);
  UART->UART_MR.write(UART_MR_PAR_NO);
  UART->UART_BRGR.write(UART_BRGR_CD(kDivider));
  UART->UART_RPR.write(address_of(receive_ring));
  UART->UART_RCR.write(kReceiveHalf);
  UART->UART_RNPR.write(address_of(receive_ring + kReceiveHalf));
  UART->UART_RNCR.write(kReceiveHalf);
  offered = kReceiveBytes;
  UART->UART_PTCR.write(UART_PTCR_RXTEN | UART_PTCR_TXTEN);
  UART->UART_CR.write(UART_CR_RXEN | UART_CR_TXEN);
}

void service() {
  service_receiver();
  service_transmitter();
}

std::size_t receive(std::uint8_t* to, std::size_t capacity) {
  service_receiver();
  const std::uint32_t available = received - fetched;
  const auto count = static_cast<std::uint32_t>(capacity < available ? capacity : available);
  for (std::uint32_t i = 0; i < count; ++i) to[i] = receive_ring[(fetched + i) % kReceiveBytes];
  fetched += count;
  return count;
}

std::size_t transmit_free() {
  return kTransmitBytes - (queued - given_to_pdc) - bytes_to_move(UART->UART_TCR, UART->UART_TNCR);
}

void transmit(const std::uint8_t* bytes, std::size_t count) {
  const std::uint32_t start = queued % kTransmitBytes;
  const std::size_t until_ring_end = kTransmitBytes - start;
  const std::size_t first = count < until_ring_end ? count : until_ring_end;
  std::memcpy(transmit_ring + start, bytes, first);
  std::memcpy(transmit_ring, bytes + first, count - first);
  queued += static_cast<std::uint32_t>(count);
  service_transmitter();
}

}  // namespace heli::due::uart
