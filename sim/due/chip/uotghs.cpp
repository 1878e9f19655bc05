// Registers of the USB controller, as far as start-up code needs them; see uotghs.hpp.
#include "chip/uotghs.hpp"

namespace due_emulator {

namespace {

using access::kBoth;
using access::kRead;
using access::kUnmodelled;
using access::kWrite;

constexpr std::uint8_t kReadNot = kRead | kUnmodelled;
constexpr std::uint8_t kWriteNot = kWrite | kUnmodelled;
constexpr std::uint8_t kBothNot = kBoth | kUnmodelled;

// One register for each of ten endpoints or pipes.
#define DUE_TEN(offset, name, access)                                           \
  {(offset) + 0x00, name "0", access}, {(offset) + 0x04, name "1", access},     \
      {(offset) + 0x08, name "2", access}, {(offset) + 0x0C, name "3", access}, \
      {(offset) + 0x10, name "4", access}, {(offset) + 0x14, name "5", access}, \
      {(offset) + 0x18, name "6", access}, {(offset) + 0x1C, name "7", access}, \
      {(offset) + 0x20, name "8", access}, {                                    \
    (offset) + 0x24, name "9", access                                           \
  }
// The four registers of a DMA channel.
#define DUE_DMA(offset, side, channel)                                   \
  {(offset) + 0x0, "UOTGHS_" side "DMANXTDSC" channel, kBothNot},        \
      {(offset) + 0x4, "UOTGHS_" side "DMAADDRESS" channel, kBothNot},   \
      {(offset) + 0x8, "UOTGHS_" side "DMACONTROL" channel, kBothNot}, { \
    (offset) + 0xC, "UOTGHS_" side "DMASTATUS" channel, kBothNot         \
  }

constexpr Register kRegisters[] = {
    {0x000, "UOTGHS_DEVCTRL", kBoth},
    {0x004, "UOTGHS_DEVISR", kRead},
    {0x008, "UOTGHS_DEVICR", kWrite},
    {0x00C, "UOTGHS_DEVIFR", kWriteNot},
    {0x010, "UOTGHS_DEVIMR", kRead},
    {0x014, "UOTGHS_DEVIDR", kWrite},
    {0x018, "UOTGHS_DEVIER", kWrite},
    {0x01C, "UOTGHS_DEVEPT", kBoth},
    {0x020, "UOTGHS_DEVFNUM", kRead},
    DUE_TEN(0x100, "UOTGHS_DEVEPTCFG", kBothNot),
    DUE_TEN(0x130, "UOTGHS_DEVEPTISR", kReadNot),
    DUE_TEN(0x160, "UOTGHS_DEVEPTICR", kWriteNot),
    DUE_TEN(0x190, "UOTGHS_DEVEPTIFR", kWriteNot),
    DUE_TEN(0x1C0, "UOTGHS_DEVEPTIMR", kReadNot),
    DUE_TEN(0x1F0, "UOTGHS_DEVEPTIER", kWriteNot),
    DUE_TEN(0x220, "UOTGHS_DEVEPTIDR", kWriteNot),
    DUE_DMA(0x310, "DEV", "1"),
    DUE_DMA(0x320, "DEV", "2"),
    DUE_DMA(0x330, "DEV", "3"),
    DUE_DMA(0x340, "DEV", "4"),
    DUE_DMA(0x350, "DEV", "5"),
    DUE_DMA(0x360, "DEV", "6"),
    DUE_DMA(0x370, "DEV", "7"),
    {0x400, "UOTGHS_HSTCTRL", kBothNot},
    {0x404, "UOTGHS_HSTISR", kReadNot},
    {0x408, "UOTGHS_HSTICR", kWriteNot},
    {0x40C, "UOTGHS_HSTIFR", kWriteNot},
    {0x410, "UOTGHS_HSTIMR", kReadNot},
    {0x414, "UOTGHS_HSTIDR", kWriteNot},
    {0x418, "UOTGHS_HSTIER", kWriteNot},
    {0x41C, "UOTGHS_HSTPIP", kBothNot},
    {0x420, "UOTGHS_HSTFNUM", kBothNot},
    {0x424, "UOTGHS_HSTADDR1", kBothNot},
    {0x428, "UOTGHS_HSTADDR2", kBothNot},
    {0x42C, "UOTGHS_HSTADDR3", kBothNot},
    DUE_TEN(0x500, "UOTGHS_HSTPIPCFG", kBothNot),
    DUE_TEN(0x530, "UOTGHS_HSTPIPISR", kReadNot),
    DUE_TEN(0x560, "UOTGHS_HSTPIPICR", kWriteNot),
    DUE_TEN(0x590, "UOTGHS_HSTPIPIFR", kWriteNot),
    DUE_TEN(0x5C0, "UOTGHS_HSTPIPIMR", kReadNot),
    DUE_TEN(0x5F0, "UOTGHS_HSTPIPIER", kWriteNot),
    DUE_TEN(0x620, "UOTGHS_HSTPIPIDR", kWriteNot),
    DUE_TEN(0x650, "UOTGHS_HSTPIPINRQ", kBothNot),
    DUE_TEN(0x680, "UOTGHS_HSTPIPERR", kBothNot),
    DUE_DMA(0x710, "HST", "1"),
    DUE_DMA(0x720, "HST", "2"),
    DUE_DMA(0x730, "HST", "3"),
    DUE_DMA(0x740, "HST", "4"),
    DUE_DMA(0x750, "HST", "5"),
    DUE_DMA(0x760, "HST", "6"),
    DUE_DMA(0x770, "HST", "7"),
    {0x800, "UOTGHS_CTRL", kBoth},
    {0x804, "UOTGHS_SR", kRead},
    {0x808, "UOTGHS_SCR", kWrite},
    {0x80C, "UOTGHS_SFR", kWriteNot},
    {0x82C, "UOTGHS_FSM", kRead},
};

// Offsets of the registers that the code below names.
constexpr std::uint32_t kDevctrl = 0x00;
constexpr std::uint32_t kDevimr = 0x10;
constexpr std::uint32_t kDevidr = 0x14;
constexpr std::uint32_t kDevier = 0x18;
constexpr std::uint32_t kDevept = 0x1C;
constexpr std::uint32_t kCtrl = 0x800;
constexpr std::uint32_t kSr = 0x804;
constexpr std::uint32_t kFsm = 0x82C;
#undef DUE_TEN
#undef DUE_DMA

constexpr std::uint32_t kControlReset = 0x03004000;  // device mode, UOTGID decides, clock frozen
constexpr std::uint32_t kUsbe = 1U << 15;            // CTRL.USBE
constexpr std::uint32_t kDetached = 1U << 8;         // DEVCTRL.DETACH
constexpr std::uint32_t kIdIsDevice = 1U << 10;      // SR.ID
constexpr std::uint32_t kClkUsable = 1U << 14;       // SR.CLKUSABLE
constexpr std::uint32_t kIdleState = 9;              // FSM.DRDSTATE: B_IDLE

}  // namespace

Uotghs::Uotghs(System& system)
    : Peripheral(system, "UOTGHS", 0x400AC000, 0x4000, id::kUotghs, kRegisters) {}

void Uotghs::reset() {
  control_ = kControlReset;
  device_ = kDetached;
  interrupts_ = endpoints_ = 0;
}

// The state of a port with no cable: a device by its ID pin, idle, and detached.
std::uint32_t Uotghs::read(std::uint32_t offset) {
  switch (offset) {
    case kDevctrl:
      return device_;
    case kDevimr:
      return interrupts_;
    case kDevept:
      return endpoints_;
    case kCtrl:
      return control_;
    case kSr:
      return kIdIsDevice | ((control_ & kUsbe) != 0 && system_.upll_locked ? kClkUsable : 0);
    case kFsm:
      return kIdleState;
    default:
      return 0;
  }
}

// The registers only keep what is written.
void Uotghs::write(std::uint32_t offset, std::uint32_t value) {
  switch (offset) {
    case kDevctrl:
      device_ = value;
      return;
    case kDevidr:
      interrupts_ &= ~value;
      return;
    case kDevier:
      interrupts_ |= value;
      return;
    case kDevept:
      endpoints_ = value;
      return;
    case kCtrl:
      control_ = value;
      return;
    default:
      return;
  }
}

}  // namespace due_emulator
