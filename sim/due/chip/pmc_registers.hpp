// Registers of the PMC and their bits by the datasheet's names (section 28).
#pragma once

#include "chip/peripheral.hpp"

namespace due_emulator::pmc {

using access::kBoth;
using access::kProtected;
using access::kRead;
using access::kUnmodelled;
using access::kWrite;

inline constexpr Register kRegisters[] = {
    {0x000, "PMC_SCER", kWrite | kProtected},
    {0x004, "PMC_SCDR", kWrite | kProtected},
    {0x008, "PMC_SCSR", kRead},
    {0x010, "PMC_PCER0", kWrite | kProtected},
    {0x014, "PMC_PCDR0", kWrite | kProtected},
    {0x018, "PMC_PCSR0", kRead},
    {0x01C, "CKGR_UCKR", kBoth | kProtected},
    {0x020, "CKGR_MOR", kBoth | kProtected},
    {0x024, "CKGR_MCFR", kRead},
    {0x028, "CKGR_PLLAR", kBoth | kProtected},
    {0x030, "PMC_MCKR", kBoth | kProtected},
    {0x038, "PMC_USB", kBoth | kProtected},
    {0x040, "PMC_PCK0", kBoth | kUnmodelled},
    {0x044, "PMC_PCK1", kBoth | kUnmodelled},
    {0x048, "PMC_PCK2", kBoth | kUnmodelled},
    {0x060, "PMC_IER", kWrite | kUnmodelled},
    {0x064, "PMC_IDR", kWrite | kUnmodelled},
    {0x068, "PMC_SR", kRead},
    {0x06C, "PMC_IMR", kRead | kUnmodelled},
    {0x070, "PMC_FSMR", kBoth | kUnmodelled},
    {0x074, "PMC_FSPR", kBoth | kUnmodelled},
    {0x078, "PMC_FOCR", kWrite | kUnmodelled},
    {0x0E4, "PMC_WPMR", kBoth},
    {0x0E8, "PMC_WPSR", kRead},
    {0x100, "PMC_PCER1", kWrite | kProtected},
    {0x104, "PMC_PCDR1", kWrite | kProtected},
    {0x108, "PMC_PCSR1", kRead},
    {0x10C, "PMC_PCR", kBoth | kUnmodelled},
};

// Offsets of the registers that the model names.
inline constexpr std::uint32_t kScer = 0x00;
inline constexpr std::uint32_t kScdr = 0x04;
inline constexpr std::uint32_t kScsr = 0x08;
inline constexpr std::uint32_t kPcer0 = 0x10;
inline constexpr std::uint32_t kPcdr0 = 0x14;
inline constexpr std::uint32_t kPcsr0 = 0x18;
inline constexpr std::uint32_t kUckr = 0x1C;
inline constexpr std::uint32_t kMor = 0x20;
inline constexpr std::uint32_t kMcfr = 0x24;
inline constexpr std::uint32_t kPllar = 0x28;
inline constexpr std::uint32_t kMckr = 0x30;
inline constexpr std::uint32_t kUsb = 0x38;
inline constexpr std::uint32_t kSr = 0x68;
inline constexpr std::uint32_t kWpmr = 0xE4;
inline constexpr std::uint32_t kPcer1 = 0x100;
inline constexpr std::uint32_t kPcdr1 = 0x104;
inline constexpr std::uint32_t kPcsr1 = 0x108;

// CKGR_MOR
inline constexpr std::uint32_t kMoscXtEn = 1U << 0;
inline constexpr std::uint32_t kMoscRcEn = 1U << 3;
inline constexpr std::uint32_t kMoscSel = 1U << 24;

// PMC_SR
inline constexpr std::uint32_t kMoscXtS = 1U << 0;
inline constexpr std::uint32_t kLockA = 1U << 1;
inline constexpr std::uint32_t kMckRdy = 1U << 3;
inline constexpr std::uint32_t kLockU = 1U << 6;
inline constexpr std::uint32_t kMoscSelS = 1U << 16;
inline constexpr std::uint32_t kMoscRcS = 1U << 17;

// CKGR_UCKR: bits that no field names read as they do after reset until they are written.
inline constexpr std::uint32_t kUckrReset = 0x10200800;
inline constexpr std::uint32_t kUpllEn = 1U << 16;
// PMC_SCSR.UOTGCLK, the 48 MHz of the USB port; bit 0 always reads 1.
inline constexpr std::uint32_t kUsbClock = 1U << 5;

}  // namespace due_emulator::pmc
