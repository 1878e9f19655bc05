// Blinks a LED at D40 (PC8) by a clock of milliseconds: 10 on, 10 off.
#include "due.h"

volatile uint32_t millis;

void systick_handler(void) { millis = millis + 1; }

static void delay_ms(uint32_t ms) {
  const uint32_t start = millis;
  while (millis - start < ms) {
  }
}

int main(void) {
  start_clock();
  start_systick();
  PIOC_PER = PIOC_OER = 1u << 8;
  for (;;) {
    PIOC_SODR = 1u << 8;
    delay_ms(10);
    PIOC_CODR = 1u << 8;
    delay_ms(10);
  }
}
