// Sends back what it receives, capitals for small letters: an interrupt fills a ring, main empties it.
#include "due.h"

static volatile uint8_t ring[64];
static volatile uint32_t written;

void uart_handler(void) {
  while (UART_SR & 1u) {
    ring[written % sizeof ring] = (uint8_t)UART_RHR;
    written = written + 1;
  }
}

int main(void) {
  start_clock();
  start_uart();
  UART_IER = 1u;
  NVIC_ISER0 = 1u << kUart;
  for (uint32_t read = 0;;) {
    if (read == written) continue;
    uint8_t byte = ring[read++ % sizeof ring];
    if (byte >= 'a' && byte <= 'z') byte = (uint8_t)(byte - 'a' + 'A');
    wait_for(&UART_SR, 1u << 1);
    UART_THR = byte;
  }
}
