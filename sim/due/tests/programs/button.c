// Says "ready" on the serial port, then "pressed" each time that pin 36 is put to ground; LED "L" shows it.
#include "due.h"

int main(void) {
  start_clock();
  PMC_PCER0 = 1u << kPioC;
  PIOC_PER = PIOC_PUER = 1u << 4;
  PIOB_OER = PIOB_CODR = 1u << 27;
  start_uart();
  say("ready\r\n");
  for (uint32_t before = 0;;) {
    const uint32_t pressed = ~PIOC_PDSR >> 4 & 1u;
    if (pressed == before) continue;
    before = pressed;
    if (pressed) PIOB_SODR = 1u << 27;
    if (!pressed) PIOB_CODR = 1u << 27;
    if (pressed) say("pressed\r\n");
  }
}
