// Says hello on UART0 at 250 kbaud, counts SysTicks in a function of its own, and fails on demand.
#include <stdint.h>

#define REG(address) (*(volatile uint32_t*)(address))

enum { kPmc = 0x400E0600, kEfc0 = 0x400E0A00, kEfc1 = 0x400E0C00, kUart = 0x400E0800, kPioA = 0x400E0E00 };

volatile uint32_t ticks;
volatile uint32_t trouble;

static void wait(uint32_t address, uint32_t bit) {
  while ((REG(address) & bit) == 0) {
  }
}

static void full_speed(void) {
  REG(kEfc0) = 4u << 8;
  REG(kEfc1) = 4u << 8;
  REG(kPmc + 0x20) = 0x37u << 16 | 8u << 8 | 9u;
  wait(kPmc + 0x68, 1u);
  REG(kPmc + 0x20) = 0x37u << 16 | 1u << 24 | 8u << 8 | 9u;
  REG(kPmc + 0x30) = 1u;
  wait(kPmc + 0x68, 8u);
  REG(kPmc + 0x28) = 1u << 29 | 13u << 16 | 0x3Fu << 8 | 1u;
  wait(kPmc + 0x68, 2u);
  REG(kPmc + 0x30) = 0x11u;
  wait(kPmc + 0x68, 8u);
  REG(kPmc + 0x30) = 0x12u;
  wait(kPmc + 0x68, 8u);
}

static void say(const char* text) {
  for (; *text != 0; ++text) {
    wait(kUart + 0x14, 2u);
    REG(kUart + 0x1C) = (uint8_t)*text;
  }
}

__attribute__((noinline)) uint32_t work(uint32_t count) {
  uint32_t sum = 0;
  for (uint32_t i = 0; i < count; ++i) {
    sum += i * i;
    __asm volatile("" : "+r"(sum));
  }
  return sum;
}

void systick_handler(void) { ticks = ticks + 1; }

int main(void) {
  REG(0x400E1A54) = 1u << 15;  // WDT_MR: WDDIS
  full_speed();
  REG(kPmc + 0x10) = 1u << 8;  // PCER0: UART
  REG(kPioA + 4) = 0x300u;     // PDR: the UART's pins
  REG(kUart + 4) = 4u << 9;    // MR: no parity
  REG(kUart + 0x20) = 21u;     // BRGR: 250 kbaud
  REG(kUart) = 0x50u;          // CR: RXEN, TXEN
  say("hello\n");
  REG(0xE000E014) = 84000u - 1u;  // SYST_RVR: each millisecond
  REG(0xE000E018) = 0u;           // SYST_CVR
  REG(0xE000E010) = 7u;           // SYST_CSR: ENABLE, TICKINT, CLKSOURCE
  for (;;) {
    __asm volatile("wfi");
    work(20);
    if (trouble == 1) __asm volatile("udf #0");
    if (trouble == 2) (void)REG(0x40008010);
    if (trouble == 3) say("!\n");
  }
}
