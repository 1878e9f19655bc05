// Registers of the SAM3X8E that this firmware uses, named as in its datasheet.
//
// A register has read() and write() only where the chip has them. Offsets, accesses, bit positions,
// addresses and identifiers are compared with the vendor's description in tests/firmware.
#pragma once

#include <cstdint>

namespace heli::due {

class ReadOnly {
 public:
  std::uint32_t read() const { return value_; }

 private:
  volatile std::uint32_t value_;
};

class WriteOnly {
 public:
  void write(std::uint32_t value) { value_ = value; }

 private:
  volatile std::uint32_t value_;
};

class ReadWrite {
 public:
  std::uint32_t read() const { return value_; }
  void write(std::uint32_t value) { value_ = value; }

 private:
  volatile std::uint32_t value_;
};

template <unsigned kWords>
using Reserved = std::uint32_t[kWords];

// A block of registers at a fixed address: PMC->PMC_SR.read().
template <class Block>
struct At {
  std::uint32_t address;
  Block* operator->() const { return reinterpret_cast<Block*>(address); }
};

constexpr std::uint32_t bit(unsigned offset) { return 1U << offset; }

// Some neighbouring bits of a register: EEFC_FMR_FWS(4) is a value to write.
struct Field {
  unsigned offset;
  unsigned width;
  constexpr std::uint32_t operator()(std::uint32_t value) const {
    return (value & ((1U << width) - 1U)) << offset;
  }
  constexpr std::uint32_t of(std::uint32_t reg) const {
    return (reg >> offset) & ((1U << width) - 1U);
  }
};

// Identifiers: bits of the peripheral clock registers, and interrupt numbers.
inline constexpr unsigned ID_PIOA = 11;
inline constexpr unsigned ID_PIOB = 12;
inline constexpr unsigned ID_PIOC = 13;
inline constexpr unsigned ID_PIOD = 14;
inline constexpr unsigned ID_UART = 8;
inline constexpr unsigned ID_TC0 = 27;
inline constexpr unsigned ID_TC3 = 30;
inline constexpr unsigned ID_TC4 = 31;
inline constexpr unsigned ID_TC6 = 33;
inline constexpr unsigned ID_PWM = 36;
inline constexpr unsigned ID_TRNG = 41;

struct Pmc {
  Reserved<4> reserved_00;
  WriteOnly PMC_PCER0;
  Reserved<3> reserved_14;
  ReadWrite CKGR_MOR;
  Reserved<1> reserved_24;
  ReadWrite CKGR_PLLAR;
  Reserved<1> reserved_2c;
  ReadWrite PMC_MCKR;
  Reserved<13> reserved_34;
  ReadOnly PMC_SR;
  Reserved<37> reserved_6c;
  WriteOnly PMC_PCER1;
};
inline constexpr At<Pmc> PMC{0x400E0600};
inline constexpr std::uint32_t CKGR_MOR_MOSCXTEN = bit(0);
inline constexpr std::uint32_t CKGR_MOR_MOSCRCEN = bit(3);
inline constexpr Field CKGR_MOR_MOSCXTST{8, 8};
inline constexpr Field CKGR_MOR_KEY{16, 8};
inline constexpr std::uint32_t CKGR_MOR_MOSCSEL = bit(24);
inline constexpr Field CKGR_PLLAR_DIVA{0, 8};
inline constexpr Field CKGR_PLLAR_PLLACOUNT{8, 6};
inline constexpr Field CKGR_PLLAR_MULA{16, 11};
inline constexpr std::uint32_t CKGR_PLLAR_ONE = bit(29);
inline constexpr Field PMC_MCKR_CSS{0, 2};
inline constexpr Field PMC_MCKR_PRES{4, 3};
inline constexpr std::uint32_t PMC_MCKR_CSS_MAIN_CLK = PMC_MCKR_CSS(1);
inline constexpr std::uint32_t PMC_MCKR_CSS_PLLA_CLK = PMC_MCKR_CSS(2);
inline constexpr std::uint32_t PMC_MCKR_PRES_CLK_2 = PMC_MCKR_PRES(1);
inline constexpr std::uint32_t PMC_SR_MOSCXTS = bit(0);
inline constexpr std::uint32_t PMC_SR_LOCKA = bit(1);
inline constexpr std::uint32_t PMC_SR_MCKRDY = bit(3);
inline constexpr std::uint32_t PMC_SR_MOSCSELS = bit(16);

struct Uart {
  WriteOnly UART_CR;
  ReadWrite UART_MR;
  Reserved<6> reserved_08;
  ReadWrite UART_BRGR;
  Reserved<55> reserved_24;
  ReadWrite UART_RPR;
  ReadWrite UART_RCR;
  ReadWrite UART_TPR;
  ReadWrite UART_TCR;
  ReadWrite UART_RNPR;
  ReadWrite UART_RNCR;
  ReadWrite UART_TNPR;
  ReadWrite UART_TNCR;
  WriteOnly UART_PTCR;
};
inline constexpr At<Uart> UART{0x400E0800};
inline constexpr std::uint32_t UART_CR_RSTRX = bit(2);
inline constexpr std::uint32_t UART_CR_RSTTX = bit(3);
inline constexpr std::uint32_t UART_CR_RXEN = bit(4);
inline constexpr std::uint32_t UART_CR_TXEN = bit(6);
inline constexpr std::uint32_t UART_CR_RSTSTA = bit(8);
inline constexpr Field UART_MR_PAR{9, 3};
inline constexpr std::uint32_t UART_MR_PAR_NO = UART_MR_PAR(4);
inline constexpr Field UART_BRGR_CD{0, 16};
inline constexpr std::uint32_t UART_PTCR_RXTEN = bit(0);
inline constexpr std::uint32_t UART_PTCR_TXTEN = bit(8);

struct Efc {
  ReadWrite EEFC_FMR;
  WriteOnly EEFC_FCR;
  ReadOnly EEFC_FSR;
};
inline constexpr At<Efc> EFC0{0x400E0A00};
inline constexpr At<Efc> EFC1{0x400E0C00};
inline constexpr Field EEFC_FMR_FWS{8, 4};
inline constexpr Field EEFC_FCR_FCMD{0, 8};
inline constexpr Field EEFC_FCR_FARG{8, 16};
inline constexpr Field EEFC_FCR_FKEY{24, 8};
inline constexpr std::uint32_t EEFC_FSR_FRDY = bit(0);
inline constexpr std::uint32_t EEFC_FSR_FCMDE = bit(1);
inline constexpr std::uint32_t EEFC_FSR_FLOCKE = bit(2);

struct Pio {
  WriteOnly PIO_PER;
  WriteOnly PIO_PDR;
  Reserved<2> reserved_08;
  WriteOnly PIO_OER;
  WriteOnly PIO_ODR;
  Reserved<6> reserved_18;
  WriteOnly PIO_SODR;
  WriteOnly PIO_CODR;
  Reserved<1> reserved_38;
  ReadOnly PIO_PDSR;
  WriteOnly PIO_IER;
  WriteOnly PIO_IDR;
  Reserved<1> reserved_48;
  ReadOnly PIO_ISR;
  Reserved<4> reserved_50;
  WriteOnly PIO_PUDR;
  WriteOnly PIO_PUER;
  Reserved<2> reserved_68;
  ReadWrite PIO_ABSR;
};
inline constexpr At<Pio> PIOA{0x400E0E00};
inline constexpr At<Pio> PIOB{0x400E1000};
inline constexpr At<Pio> PIOC{0x400E1200};
inline constexpr At<Pio> PIOD{0x400E1400};

struct Rstc {
  WriteOnly RSTC_CR;
  ReadOnly RSTC_SR;
};
inline constexpr At<Rstc> RSTC{0x400E1A00};
inline constexpr std::uint32_t RSTC_CR_PROCRST = bit(0);
inline constexpr std::uint32_t RSTC_CR_PERRST = bit(2);
inline constexpr Field RSTC_CR_KEY{24, 8};
inline constexpr Field RSTC_SR_RSTTYP{8, 3};

struct Wdt {
  WriteOnly WDT_CR;
  ReadWrite WDT_MR;
};
inline constexpr At<Wdt> WDT{0x400E1A50};
inline constexpr std::uint32_t WDT_CR_WDRSTT = bit(0);
inline constexpr Field WDT_CR_KEY{24, 8};
inline constexpr Field WDT_MR_WDV{0, 12};
inline constexpr std::uint32_t WDT_MR_WDRSTEN = bit(13);
inline constexpr Field WDT_MR_WDD{16, 12};
inline constexpr std::uint32_t WDT_MR_WDDBGHLT = bit(28);

// Eight words in the backup domain: they live through every reset but that of the power.
struct Gpbr {
  ReadWrite SYS_GPBR[8];
};
inline constexpr At<Gpbr> GPBR{0x400E1A90};

struct TcChannel {
  WriteOnly TC_CCR;
  ReadWrite TC_CMR;
  Reserved<2> reserved_08;
  ReadOnly TC_CV;
  Reserved<2> reserved_14;
  ReadWrite TC_RC;
  ReadOnly TC_SR;
  WriteOnly TC_IER;
  Reserved<6> reserved_28;
};
struct Tc {
  TcChannel TC_CHANNEL[3];
  Reserved<1> reserved_c0;
  ReadWrite TC_BMR;
  Reserved<3> reserved_c8;
  ReadOnly TC_QISR;
};
inline constexpr At<Tc> TC0{0x40080000};
inline constexpr At<Tc> TC1{0x40084000};
inline constexpr At<Tc> TC2{0x40088000};
inline constexpr std::uint32_t TC_CCR_CLKEN = bit(0);
inline constexpr std::uint32_t TC_CCR_SWTRG = bit(2);
inline constexpr Field TC_CMR_TCCLKS{0, 3};
inline constexpr std::uint32_t TC_CMR_TCCLKS_TIMER_CLOCK1 = TC_CMR_TCCLKS(0);
inline constexpr std::uint32_t TC_CMR_TCCLKS_XC0 = TC_CMR_TCCLKS(5);
inline constexpr Field TC_CMR_ETRGEDG{8, 2};
inline constexpr std::uint32_t TC_CMR_ETRGEDG_RISING = TC_CMR_ETRGEDG(1);
inline constexpr std::uint32_t TC_CMR_ABETRG = bit(10);
inline constexpr Field TC_CMR_WAVSEL{13, 2};
inline constexpr std::uint32_t TC_CMR_WAVSEL_UP_RC = TC_CMR_WAVSEL(2);
inline constexpr std::uint32_t TC_CMR_WAVE = bit(15);
inline constexpr std::uint32_t TC_IER_CPCS = bit(4);
inline constexpr std::uint32_t TC_BMR_QDEN = bit(8);
inline constexpr std::uint32_t TC_BMR_POSEN = bit(9);
inline constexpr std::uint32_t TC_BMR_EDGPHA = bit(12);
inline constexpr std::uint32_t TC_BMR_FILTER = bit(19);
inline constexpr Field TC_BMR_MAXFILT{20, 6};
inline constexpr std::uint32_t TC_QISR_QERR = bit(2);

struct PwmChannel {
  ReadWrite PWM_CMR;
  ReadWrite PWM_CDTY;
  WriteOnly PWM_CDTYUPD;
  ReadWrite PWM_CPRD;
  Reserved<4> reserved_10;
};
struct Pwm {
  Reserved<1> reserved_000;
  WriteOnly PWM_ENA;
  Reserved<6> reserved_008;
  ReadWrite PWM_SCM;
  Reserved<1> reserved_024;
  ReadWrite PWM_SCUC;
  Reserved<6> reserved_02c;
  ReadWrite PWM_OOV;
  Reserved<1> reserved_048;
  WriteOnly PWM_OSS;
  WriteOnly PWM_OSC;
  Reserved<2> reserved_054;
  ReadWrite PWM_FMR;
  ReadOnly PWM_FSR;
  WriteOnly PWM_FCR;
  ReadWrite PWM_FPV;
  ReadWrite PWM_FPE1;
  ReadWrite PWM_FPE2;
  Reserved<99> reserved_074;
  PwmChannel PWM_CH_NUM[8];
};
inline constexpr At<Pwm> PWM{0x40094000};
inline constexpr Field PWM_SCM_UPDM{16, 2};
inline constexpr std::uint32_t PWM_SCM_UPDM_MODE0 = PWM_SCM_UPDM(0);
inline constexpr std::uint32_t PWM_SCUC_UPDULOCK = bit(0);
inline constexpr Field PWM_FMR_FPOL{0, 8};
inline constexpr Field PWM_FMR_FMOD{8, 8};
inline constexpr Field PWM_FMR_FFIL{16, 8};
inline constexpr Field PWM_FSR_FIV{0, 8};
inline constexpr Field PWM_FSR_FS{8, 8};
inline constexpr Field PWM_FCR_FCLR{0, 8};
inline constexpr Field PWM_CMR_CPRE{0, 4};
inline constexpr std::uint32_t PWM_CMR_CPRE_MCK = PWM_CMR_CPRE(0);
inline constexpr std::uint32_t PWM_CMR_CALG = bit(8);
inline constexpr std::uint32_t PWM_CMR_CPOL = bit(9);

struct Trng {
  WriteOnly TRNG_CR;
  Reserved<6> reserved_04;
  ReadOnly TRNG_ISR;
  Reserved<12> reserved_20;
  ReadOnly TRNG_ODATA;
};
inline constexpr At<Trng> TRNG{0x400BC000};
inline constexpr std::uint32_t TRNG_CR_ENABLE = bit(0);
inline constexpr Field TRNG_CR_KEY{8, 24};
inline constexpr std::uint32_t TRNG_ISR_DATRDY = bit(0);

}  // namespace heli::due
