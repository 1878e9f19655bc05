// Registers of the system control space by their names in the ARMv7-M manual (B3.2 to B3.4, C1.6
// and C1.8), and the bits that the model reads or writes.
#pragma once

#include <cstdint>

namespace due_emulator::scs {

// Addresses of the data watchpoint and trace unit, which counts processor cycles.
inline constexpr std::uint32_t kDwtCtrl = 0xE0001000;
inline constexpr std::uint32_t kDwtCyccnt = 0xE0001004;
inline constexpr std::uint32_t kDwtCycCntEna = 1U << 0;     // DWT_CTRL.CYCCNTENA
inline constexpr std::uint32_t kDwtNumComp = 0x40000000;    // DWT_CTRL.NUMCOMP: 4 comparators
inline constexpr std::uint32_t kDwtReadOnly = 0xF0000000U;  // NUMCOMP ignores writes

// The system control space is one page; the registers below are offsets in it.
inline constexpr std::uint32_t kBase = 0xE000E000;
inline constexpr std::uint32_t kEnd = 0xE000F000;

inline constexpr std::uint32_t kIctr = 0x004;       // interrupt lines, in groups of 32
inline constexpr std::uint32_t kActlr = 0x008;      // auxiliary control
inline constexpr std::uint32_t kSystCsr = 0x010;    // SysTick control and status
inline constexpr std::uint32_t kSystRvr = 0x014;    // SysTick reload value
inline constexpr std::uint32_t kSystCvr = 0x018;    // SysTick current value
inline constexpr std::uint32_t kSystCalib = 0x01C;  // SysTick reload value for a known time

// NVIC. Each of the five bit arrays has one bit per interrupt; NVIC_IPR has one byte.
inline constexpr std::uint32_t kNvicIser = 0x100;   // set enable
inline constexpr std::uint32_t kNvicIcer = 0x180;   // clear enable
inline constexpr std::uint32_t kNvicIspr = 0x200;   // set pending
inline constexpr std::uint32_t kNvicIcpr = 0x280;   // clear pending
inline constexpr std::uint32_t kNvicIpr = 0x400;    // priorities
inline constexpr std::uint32_t kNvicEnd = 0x500;    // the first offset behind NVIC_IPR
inline constexpr std::uint32_t kNvicArray = 0x780;  // mask: which bit array an offset is in
inline constexpr std::uint32_t kNvicByte = 0x07F;   // mask: which byte of that array

inline constexpr std::uint32_t kCpuid = 0xD00;
inline constexpr std::uint32_t kIcsr = 0xD04;   // interrupt control and state
inline constexpr std::uint32_t kVtor = 0xD08;   // vector table offset
inline constexpr std::uint32_t kAircr = 0xD0C;  // priority grouping, system reset
inline constexpr std::uint32_t kScr = 0xD10;    // sleep
inline constexpr std::uint32_t kCcr = 0xD14;    // configuration and control
inline constexpr std::uint32_t kShpr1 = 0xD18;  // priorities of exceptions 4 to 7
inline constexpr std::uint32_t kShpr2 = 0xD1C;  // 8 to 11
inline constexpr std::uint32_t kShpr3 = 0xD20;  // 12 to 15
inline constexpr std::uint32_t kShcsr = 0xD24;  // system handler control and state
inline constexpr std::uint32_t kCfsr = 0xD28;   // configurable fault status
inline constexpr std::uint32_t kHfsr = 0xD2C;   // HardFault status
inline constexpr std::uint32_t kDfsr = 0xD30;   // debug fault status
inline constexpr std::uint32_t kMmfar = 0xD34;  // address of a MemManage fault
inline constexpr std::uint32_t kBfar = 0xD38;   // address of a BusFault
inline constexpr std::uint32_t kAfsr = 0xD3C;   // auxiliary fault status
inline constexpr std::uint32_t kMpuType = 0xD90;
inline constexpr std::uint32_t kDhcsr = 0xDF0;  // debug halting control
inline constexpr std::uint32_t kDemcr = 0xDFC;  // debug exception and monitor control
inline constexpr std::uint32_t kStir = 0xF00;   // software trigger interrupt

// SYST_CSR
inline constexpr std::uint32_t kSystEnable = 1U << 0;
inline constexpr std::uint32_t kSystTickInt = 1U << 1;
inline constexpr std::uint32_t kSystClkSource = 1U << 2;  // 1: MCK, 0: MCK / 8
inline constexpr std::uint32_t kSystCountFlag = 1U << 16;
inline constexpr std::uint32_t kSystCounterMask = 0xFFFFFF;  // the counter has 24 bits

// ICSR
inline constexpr std::uint32_t kRetToBase = 1U << 11;
inline constexpr unsigned kVectPendingShift = 12;
inline constexpr std::uint32_t kIsrPending = 1U << 22;
inline constexpr std::uint32_t kPendStClr = 1U << 25;
inline constexpr std::uint32_t kPendStSet = 1U << 26;
inline constexpr std::uint32_t kPendSvClr = 1U << 27;
inline constexpr std::uint32_t kPendSvSet = 1U << 28;
inline constexpr std::uint32_t kNmiPendSet = 1U << 31;

inline constexpr std::uint32_t kVtorMask = 0x3FFFFF80;  // TBLOFF: a table begins at 128 bytes

// AIRCR. A write needs VECTKEY; a read shows its complement.
inline constexpr std::uint32_t kVectKey = 0x05FA;
inline constexpr std::uint32_t kVectKeyStat = 0xFA050000U;
inline constexpr unsigned kPriGroupShift = 8;
inline constexpr std::uint32_t kVectReset = 1U << 0;
inline constexpr std::uint32_t kSysResetReq = 1U << 2;

// SCR: SLEEPONEXIT (bit 1), SLEEPDEEP and SEVONPEND can be written.
inline constexpr std::uint32_t kSleepDeep = 1U << 2;
inline constexpr std::uint32_t kSevOnPend = 1U << 4;
inline constexpr std::uint32_t kScrMask = 0x16;

// CCR: NONBASETHRDENA (bit 0), USERSETMPEND (1), UNALIGN_TRP (3), DIV_0_TRP (4), BFHFNMIGN (8) and
// STKALIGN (9) can be written.
inline constexpr std::uint32_t kCcrMask = 0x31B;

inline constexpr std::uint32_t kTrcEna = 1U << 24;        // DEMCR.TRCENA: the trace units run
inline constexpr std::uint32_t kStirIntId = 0x1FF;        // STIR.INTID: interrupt number
inline constexpr std::uint32_t kMpuRegions = 0x00000800;  // MPU_TYPE.DREGION: 8

}  // namespace due_emulator::scs
