// Starts as programs do that could talk USB, with no cable there: pins low, ADC set up, UPLL locked, the
// USB port opened and attached. Then says so on the serial port and counts milliseconds.
#include "due.h"

volatile uint32_t millis;

void systick_handler(void) { millis = millis + 1; }

static void start_adc(void) {
  PMC_PCER1 = 1u << (kAdc - 32);
  ADC_CR = 1u;  // SWRST
  ADC_MR = 0;
  ADC_PTCR = 1u << 1 | 1u << 9;  // RXTDIS, TXTDIS
  ADC_RCR = ADC_RNCR = 0;
  ADC_MR = 1u << 8 | 4u << 16 | 1u << 20 | 1u << 28;  // PRESCAL, STARTUP, SETTLING, TRANSFER
  ADC_IDR = ~0u;
  ADC_CHDR = ~0u;
}

static void start_usb(void) {
  PMC_PCER1 = 1u << (kUotghs - 32);
  PMC_CKGR_UCKR = 3u << 20 | 1u << 16;      // UPLLCOUNT, UPLLEN
  wait_for(&PMC_SR, 1u << 6);               // LOCKU
  PMC_USB = 1u;                             // USBS: from UPLL
  PMC_SCER = 1u << 5;                       // UOTGCLK
  UOTGHS_CTRL = UOTGHS_CTRL & ~(1u << 24);  // UIDE off: device whatever UOTGID says
  UOTGHS_CTRL = UOTGHS_CTRL | 1u << 25;     // UIMOD: device
  UOTGHS_CTRL = UOTGHS_CTRL | 1u << 12;     // OTGPADE
  UOTGHS_CTRL = UOTGHS_CTRL | 1u << 15;     // USBE
  UOTGHS_CTRL = UOTGHS_CTRL & ~(1u << 14);  // FRZCLK off: the clock runs
  wait_for(&UOTGHS_SR, 1u << 14);           // CLKUSABLE
  UOTGHS_DEVCTRL = UOTGHS_DEVCTRL & ~(1u << 8);  // DETACH off
  UOTGHS_DEVIER = 1u << 3 | 1u << 4;        // EORST, WAKEUP
  UOTGHS_DEVICR = 1u << 2 | 1u << 4;        // SOF, WAKEUP
  UOTGHS_CTRL = UOTGHS_CTRL | 1u << 14;     // FRZCLK, until a cable comes
  NVIC_ISER1 = 1u << (kUotghs - 32);
}

int main(void) {
  start_clock();
  start_systick();
  PIOA_OER = PIOA_CODR = 1u << 15;  // a low output
  PIOB_OWER = PIOC_OWER = ~0u;      // writable by ODSR
  PIOB_PDR = 3u << 10;  // UOTGVBOF, UOTGID
  start_adc();
  start_usb();
  start_uart();
  say("ready\r\n");
  for (;;) {
  }
}
