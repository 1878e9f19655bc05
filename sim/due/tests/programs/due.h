// Registers of the SAM3X8E under the names of its datasheet, as far as the programs here use them, and
// what each of them starts with. Addresses are held against the vendor's description by test_programs.py.
#pragma once
#include <stdint.h>

#define REG(address) (*(volatile uint32_t*)(address))

#define ADC_CR REG(0x400C0000)
#define ADC_MR REG(0x400C0004)
#define ADC_CHER REG(0x400C0010)
#define ADC_CHDR REG(0x400C0014)
#define ADC_LCDR REG(0x400C0020)
#define ADC_IER REG(0x400C0024)
#define ADC_IDR REG(0x400C0028)
#define ADC_ISR REG(0x400C0030)
#define ADC_CDR7 REG(0x400C006C)
#define ADC_RCR REG(0x400C0104)
#define ADC_RNCR REG(0x400C0114)
#define ADC_PTCR REG(0x400C0120)
#define DACC_MR REG(0x400C8004)
#define DACC_CHER REG(0x400C8010)
#define DACC_CDR REG(0x400C8020)
#define DACC_ISR REG(0x400C8030)
#define EFC0_FMR REG(0x400E0A00)
#define EFC1_FMR REG(0x400E0C00)
#define PIOA_PDR REG(0x400E0E04)
#define PIOA_OER REG(0x400E0E10)
#define PIOA_CODR REG(0x400E0E34)
#define PIOB_PDR REG(0x400E1004)
#define PIOB_OER REG(0x400E1010)
#define PIOB_SODR REG(0x400E1030)
#define PIOB_CODR REG(0x400E1034)
#define PIOB_OWER REG(0x400E10A0)
#define PIOC_PER REG(0x400E1200)
#define PIOC_PDR REG(0x400E1204)
#define PIOC_OER REG(0x400E1210)
#define PIOC_SODR REG(0x400E1230)
#define PIOC_CODR REG(0x400E1234)
#define PIOC_ODR REG(0x400E1214)
#define PIOC_PDSR REG(0x400E123C)
#define PIOC_IER REG(0x400E1240)
#define PIOC_ISR REG(0x400E124C)
#define PIOC_PUER REG(0x400E1264)
#define PIOC_ABSR REG(0x400E1270)
#define PIOC_OWER REG(0x400E12A0)
#define PIOC_AIMER REG(0x400E12B0)
#define PIOC_ESR REG(0x400E12C0)
#define PIOC_FELLSR REG(0x400E12D0)
#define PIOC_REHLSR REG(0x400E12D4)
#define PMC_SCER REG(0x400E0600)
#define PMC_PCER0 REG(0x400E0610)
#define PMC_PCER1 REG(0x400E0700)
#define PMC_CKGR_UCKR REG(0x400E061C)
#define PMC_CKGR_MOR REG(0x400E0620)
#define PMC_CKGR_PLLAR REG(0x400E0628)
#define PMC_MCKR REG(0x400E0630)
#define PMC_USB REG(0x400E0638)
#define PMC_SR REG(0x400E0668)
#define PWM_CLK REG(0x40094000)
#define PWM_ENA REG(0x40094004)
#define PWM_CMR6 REG(0x400942C0)
#define PWM_CDTY6 REG(0x400942C4)
#define PWM_CDTYUPD6 REG(0x400942C8)
#define PWM_CPRD6 REG(0x400942CC)
#define UART_CR REG(0x400E0800)
#define UART_MR REG(0x400E0804)
#define UART_IER REG(0x400E0808)
#define UART_SR REG(0x400E0814)
#define UART_RHR REG(0x400E0818)
#define UART_THR REG(0x400E081C)
#define UART_BRGR REG(0x400E0820)
#define UOTGHS_DEVCTRL REG(0x400AC000)
#define UOTGHS_DEVICR REG(0x400AC008)
#define UOTGHS_DEVIER REG(0x400AC018)
#define UOTGHS_CTRL REG(0x400AC800)
#define UOTGHS_SR REG(0x400AC804)
#define WDT_MR REG(0x400E1A54)

// Of the Cortex-M3 itself.
#define SYSTICK_CTRL REG(0xE000E010)
#define SYSTICK_LOAD REG(0xE000E014)
#define SYSTICK_VAL REG(0xE000E018)
#define NVIC_ISER0 REG(0xE000E100)
#define NVIC_ISER1 REG(0xE000E104)

enum { kUart = 8, kPioC = 13, kPwm = 36, kAdc = 37, kDacc = 38, kUotghs = 40 };
enum {  // PMC_SR
  kCrystalStable = 1u << 0,
  kPllLocked = 1u << 1,
  kMasterClockReady = 1u << 3,
  kMainClockSelected = 1u << 16
};

static inline void wait_for(volatile uint32_t* status, uint32_t bits) {
  while ((*status & bits) != bits) {
  }
}

// Watchdog off, 84 MHz from the 12 MHz crystal.
static inline void start_clock(void) {
  WDT_MR = 1u << 15;  // No watchdog.
  EFC0_FMR = EFC1_FMR = 4u << 8;  // Four wait states of the flash, for 84 MHz.
  // The crystal of 12 MHz, then the main clock from it; writes need the key 0x37.
  PMC_CKGR_MOR = 0x37u << 16 | 8u << 8 | 9u;
  wait_for(&PMC_SR, kCrystalStable);
  PMC_CKGR_MOR = 1u << 24 | 0x37u << 16 | 8u << 8 | 9u;
  wait_for(&PMC_SR, kMainClockSelected);
  PMC_MCKR = 0x01u;  // The processor on the main clock.
  wait_for(&PMC_SR, kMasterClockReady);
  PMC_CKGR_PLLAR = 1u << 29 | 13u << 16 | 0x3Fu << 8 | 1u;  // PLL: 12 MHz times 14.
  wait_for(&PMC_SR, kPllLocked);
  PMC_MCKR = 0x11u;  // Halved first, so that no step exceeds 84 MHz, then on the PLL.
  wait_for(&PMC_SR, kMasterClockReady);
  PMC_MCKR = 0x12u;
  wait_for(&PMC_SR, kMasterClockReady);
}

// One interrupt a millisecond.
static inline void start_systick(void) {
  SYSTICK_LOAD = 84000u - 1u;
  SYSTICK_VAL = 0;
  SYSTICK_CTRL = 7u;
}

// 115200 baud, 8N1, on PA8 and PA9.
static inline void start_uart(void) {
  PMC_PCER0 = 1u << kUart;
  PIOA_PDR = 3u << 8;
  UART_MR = 4u << 9;
  UART_BRGR = 45u;
  UART_CR = 1u << 4 | 1u << 6;
}

static inline void say(const char* text) {
  for (; *text != 0; ++text) {
    wait_for(&UART_SR, 1u << 1);
    UART_THR = (uint8_t)*text;
  }
}
