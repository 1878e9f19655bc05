// Reads A0 (AD7) again and again by waiting for DRDY, and puts what it read out at DAC0; A1 (AD6) comes
// by interrupt, started each millisecond.
#include "due.h"

volatile uint32_t polled, interrupted, interrupts;

void adc_handler(void) {
  if (ADC_ISR & 1u << 6) {
    interrupted = REG(0x400C0050 + 4 * 6);
    interrupts = interrupts + 1;
  }
}

static uint32_t analog_read(uint32_t channel) {
  ADC_CHER = 1u << channel;
  ADC_CR = 2u;
  wait_for(&ADC_ISR, 1u << 24);
  ADC_CHDR = 1u << channel;
  return ADC_LCDR;
}

int main(void) {
  start_clock();
  PMC_PCER1 = 1u << (kAdc - 32) | 1u << (kDacc - 32);
  ADC_CR = 1u;                                        // SWRST
  ADC_MR = 1u << 8 | 8u << 16 | 1u << 20 | 1u << 28;  // PRESCAL, STARTUP, SETTLING, TRANSFER
  DACC_MR = 1u << 8 | 1u << 24;                       // REFRESH, STARTUP
  DACC_CHER = 1u;
  for (uint32_t i = 0;; ++i) {
    polled = analog_read(7);
    DACC_CDR = polled;
    wait_for(&DACC_ISR, 2u);  // EOC
    const uint32_t before = interrupts;
    ADC_CHER = 1u << 6;
    ADC_IER = 1u << 6;
    NVIC_ISER1 = 1u << (kAdc - 32);
    ADC_CR = 2u;  // START
    while (interrupts == before) {
    }
    ADC_IDR = 1u << 6;
    ADC_CHDR = 1u << 6;
    (void)ADC_LCDR;
  }
}
