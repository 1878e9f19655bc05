// One output of the PWM, D7 at 1 kHz, its duty raised a hundredth each period.
#include "due.h"

int main(void) {
  start_clock();
  PMC_PCER1 = 1u << (kPwm - 32);
  PWM_CLK = 42u;  // CLKA = 2 MHz
  PWM_CMR6 = 11u | 1u << 9;
  PWM_CPRD6 = 2000u;
  PWM_CDTY6 = 0u;
  PIOC_ABSR = 1u << 23;
  PIOC_PDR = 1u << 23;
  PWM_ENA = 1u << 6;
  start_systick();
  for (uint32_t duty = 0;; duty = duty < 2000u ? duty + 20u : 0u) {
    PWM_CDTYUPD6 = 2000u - duty;
    __asm volatile("wfi");
  }
}

void systick_handler(void) {}
