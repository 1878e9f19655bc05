#include "uart.hpp"

#include <cstring>

#include "clock.hpp"
#include "cortex_m3.hpp"
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
std::uint32_t received;  // up to the last reading of the PDC
std::uint32_t taken;
std::uint32_t offered;  // up to here the PDC may fill the ring
std::uint32_t queued;
std::uint32_t handed;  // up to here the PDC has been told to send

std::uint32_t address_of(const std::uint8_t* byte) {
  return static_cast<std::uint32_t>(reinterpret_cast<std::uintptr_t>(byte));
}

// Gives the PDC a buffer. What it does with a next buffer that arrives just when the present one
// ends is nowhere written, so the next pair is written only while the last byte is yet to come: of
// three that are left one may go between the look and the write, with interrupts masked no second,
// because a byte takes 40 us. False: try again later.
bool hand_over(ReadWrite& pointer, ReadWrite& counter, ReadWrite& next_pointer,
               ReadWrite& next_counter, const std::uint8_t* bytes, std::uint32_t count) {
  if (next_counter.read() != 0U) return false;
  mask_interrupts();
  const std::uint32_t left = counter.read();
  const bool chain = left > 2U;
  if (chain) {
    next_pointer.write(address_of(bytes));
    next_counter.write(count);
  } else if (left == 0U) {
    pointer.write(address_of(bytes));
    counter.write(count);
  }
  unmask_interrupts();
  return chain || left == 0U;
}

// Bytes that the PDC has yet to move, of the present and the next buffer.
std::uint32_t in_flight(const ReadWrite& counter, const ReadWrite& next_counter) {
  std::uint32_t next = 0;
  std::uint32_t present = 0;
  do {
    next = next_counter.read();
    present = counter.read();
  } while (next != next_counter.read());
  return next + present;
}

void service_receiver() {
  // By the counters and not by the pointer, which is the same in a full ring and in an empty one.
  received = offered - in_flight(UART->UART_RCR, UART->UART_RNCR);
  // A half is offered again only when all of it has been taken: bytes that nobody fetches stop the
  // receiver, they never overwrite older ones.
  if (offered - taken > kReceiveHalf) return;
  if (hand_over(UART->UART_RPR, UART->UART_RCR, UART->UART_RNPR, UART->UART_RNCR,
                receive_ring + offered % kReceiveBytes, kReceiveHalf)) {
    offered += kReceiveHalf;
  }
}

void service_transmitter() {
  const std::uint32_t waiting = queued - handed;
  if (waiting == 0U) return;
  const std::uint32_t start = handed % kTransmitBytes;
  const std::uint32_t in_a_row = kTransmitBytes - start;
  const std::uint32_t count = waiting < in_a_row ? waiting : in_a_row;
  if (hand_over(UART->UART_TPR, UART->UART_TCR, UART->UART_TNPR, UART->UART_TNCR,
                transmit_ring + start, count)) {
    handed += count;
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

std::size_t receive(std::uint8_t* to, std::size_t most) {
  service_receiver();
  const std::uint32_t waiting = received - taken;
  const auto count = static_cast<std::uint32_t>(most < waiting ? most : waiting);
  for (std::uint32_t i = 0; i < count; ++i) to[i] = receive_ring[(taken + i) % kReceiveBytes];
  taken += count;
  return count;
}

std::size_t transmit_free() {
  return kTransmitBytes - (queued - handed) - in_flight(UART->UART_TCR, UART->UART_TNCR);
}

void transmit(const std::uint8_t* bytes, std::size_t count) {
  const std::uint32_t start = queued % kTransmitBytes;
  const std::size_t in_a_row = kTransmitBytes - start;
  const std::size_t first = count < in_a_row ? count : in_a_row;
  std::memcpy(transmit_ring + start, bytes, first);
  std::memcpy(transmit_ring, bytes + first, count - first);
  queued += static_cast<std::uint32_t>(count);
  service_transmitter();
}

}  // namespace heli::due::uart
