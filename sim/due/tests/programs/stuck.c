// Waits for SPI0's transmitter, which the emulator has not, while a clock of milliseconds looks at the
// PMC. On the 4 MHz that a Due starts with.
#include "due.h"

volatile uint32_t millis, tries;

void systick_handler(void) {
  for (volatile uint32_t i = 0; i < 30; ++i) {
  }
  if (PMC_SR) millis = millis + 1;
}

static int has_room(void) { return (REG(0x40008010) & 2u) != 0; }

int main(void) {
  WDT_MR = 1u << 15;
  SYSTICK_LOAD = 4000u - 1u;
  SYSTICK_CTRL = 7u;
  while (!has_room()) tries = tries + 1;
  for (;;) __asm volatile("wfi");
}
