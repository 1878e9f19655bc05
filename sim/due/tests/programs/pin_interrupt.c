// Counts rising edges at D36 (PC4) and falling ones at D37 (PC5), each by an interrupt of its edge.
#include "due.h"

volatile uint32_t rising, falling;

void pioc_handler(void) {
  const uint32_t status = PIOC_ISR;
  if (status & 1u << 4) rising = rising + 1;
  if (status & 1u << 5) falling = falling + 1;
}

int main(void) {
  start_clock();
  PMC_PCER0 = 1u << kPioC;
  PIOC_PER = PIOC_ODR = PIOC_PUER = 3u << 4;
  PIOC_AIMER = PIOC_ESR = 3u << 4;
  PIOC_REHLSR = 1u << 4;
  PIOC_FELLSR = 1u << 5;
  (void)PIOC_ISR;
  PIOC_IER = 3u << 4;
  NVIC_ISER0 = 1u << kPioC;
  for (;;) __asm volatile("wfi");
}
