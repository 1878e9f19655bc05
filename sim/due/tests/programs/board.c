// The helicopter's wiring in a hundred lines: two decoders, one interrupt, four PWM outputs, an echo.
#include <stdint.h>

#define REG(address) (*(volatile uint32_t*)(address))

enum { kPmc = 0x400E0600, kUart = 0x400E0800, kPioA = 0x400E0E00, kPioB = 0x400E1000 };
enum { kPioC = 0x400E1200, kPioD = 0x400E1400, kTc0 = 0x40080000, kTc2 = 0x40088000, kPwm = 0x40094000 };

volatile int32_t counts[3];
volatile uint32_t duty[4];
volatile uint32_t on;
volatile uint32_t loops;

static const int8_t kSteps[16] = {0, 1, -1, 0, -1, 0, 0, 1, 1, 0, 0, -1, 0, -1, 1, 0};
static uint32_t phase;

void piod_handler(void) {
  (void)REG(kPioD + 0x4C);  // ISR: reading clears it
  phase = (phase << 2 | (REG(kPioD + 0x3C) & 3u)) & 15u;  // PDSR: old and new levels of A and B
  counts[2] += kSteps[phase];
}

// An edge of the master clock takes the trigger, which would cost the first step; returns what was counted
// until the decoder's steps became the clock.
static uint32_t decoder(uint32_t block) {
  REG(block + 0xC4) = 1u << 8 | 1u << 9 | 1u << 12 | 1u << 19 | 15u << 20;  // BMR: QDEN, POSEN, filter
  REG(block + 0x04) = 0u;                                                   // CMR: master clock
  REG(block + 0x00) = 5u;                                                   // CCR: CLKEN, SWTRG
  (void)REG(block + 0x10);                                                  // CV
  REG(block + 0x04) = 5u | 1u << 8 | 1u << 10;                              // CMR: XC0, ETRGEDG, ABETRG
  return REG(block + 0x10);
}

static void pwm(void) {
  REG(kPwm + 0x20) = 0xF1u;  // SCM: channels 0 and 4 to 7 are synchronous
  for (uint32_t channel = 0; channel < 8; ++channel) {
    const uint32_t base = kPwm + 0x200 + 32 * channel;
    if ((0xF1u >> channel & 1u) == 0) continue;
    REG(base) = 1u << 8 | 1u << 9;  // CMR: CALG, CPOL
    REG(base + 0x0C) = 2100u;       // CPRD
    REG(base + 0x04) = 2100u;       // CDTY
  }
  REG(kPwm + 0x04) = 1u;           // ENA
  REG(kPioC + 0x70) = 0xFu << 21;  // ABSR: peripheral B
  REG(kPioC + 0x04) = 0xFu << 21;  // PDR
}

static void full_speed(void) {
  REG(0x400E0A00) = 4u << 8;                      // EEFC0_FMR: 4 wait states
  REG(0x400E0C00) = 4u << 8;                      // EEFC1_FMR
  REG(kPmc + 0x20) = 0x37u << 16 | 8u << 8 | 9u;  // MOR: crystal on
  while ((REG(kPmc + 0x68) & 1u) == 0) {
  }
  REG(kPmc + 0x20) = 0x37u << 16 | 1u << 24 | 8u << 8 | 9u;   // MOR: crystal chosen
  REG(kPmc + 0x28) = 1u << 29 | 13u << 16 | 0x3Fu << 8 | 1u;  // PLLAR: 12 MHz x 14
  while ((REG(kPmc + 0x68) & 2u) == 0) {
  }
  REG(kPmc + 0x30) = 0x11u;  // MCKR: prescaler of 2, then PLLA as the source
  while ((REG(kPmc + 0x68) & 8u) == 0) {
  }
  REG(kPmc + 0x30) = 0x12u;
  while ((REG(kPmc + 0x68) & 8u) == 0) {
  }
}

int main(void) {
  REG(0x400E1A54) = 1u << 15;  // WDT_MR: WDDIS
  full_speed();
  REG(kPmc + 0x10) = 1u << 8 | 0xFu << 11 | 1u << 27;  // PCER0: UART, PIOA to D, TC0
  REG(kPmc + 0x100) = 1u << 1 | 1u << 4;               // PCER1: TC6, PWM
  const uint32_t zero[2] = {decoder(kTc0), decoder(kTc2)};
  pwm();
  phase = REG(kPioD + 0x3C) & 3u;  // PDSR: levels of A and B
  REG(kPioD + 0x40) = 3u;          // IER
  REG(0xE000E100) = 1u << 14;      // ISER0: PIOD
  REG(kPioA + 4) = 0x300u;         // PDR: the UART's pins
  REG(kUart + 4) = 4u << 9;        // MR: no parity
  REG(kUart + 0x20) = 21u;         // BRGR: 250 kbaud
  REG(kUart) = 0x50u;              // CR: RXEN, TXEN
  REG(kPioB + 0x10) = 1u << 26;    // OER: the four enables
  REG(kPioA + 0x10) = 3u << 14;
  REG(kPioD + 0x10) = 1u << 3;
  for (;;) {
    counts[0] = (int32_t)(REG(kTc0 + 0x10) - zero[0]);
    counts[1] = (int32_t)(REG(kTc2 + 0x10) - zero[1]);
    for (uint32_t i = 0; i < 4; ++i) REG(kPwm + 0x208 + 32 * (4 + i)) = 2100u - duty[i];  // CDTYUPD
    REG(kPwm + 0x28) = 1u;  // SCUC: UPDULOCK
    // SODR or CODR: the enables.
    REG(kPioB + (on ? 0x30 : 0x34)) = 1u << 26;
    REG(kPioA + (on ? 0x30 : 0x34)) = 3u << 14;
    REG(kPioD + (on ? 0x30 : 0x34)) = 1u << 3;
    // SR.RXRDY: echo the byte with its case changed.
    if (REG(kUart + 0x14) & 1u) REG(kUart + 0x1C) = REG(kUart + 0x18) ^ 0x20u;
    loops = loops + 1;
  }
}
