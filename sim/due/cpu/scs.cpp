// Reads and writes of the system control space: NVIC, SCB and debug registers; see scs.hpp.
#include "cpu/scs.hpp"

namespace due_emulator {

namespace {

constexpr std::uint32_t kCpuId = 0x412FC230;         // Cortex-M3 r2p0
constexpr std::uint32_t kInterruptLines = 1;         // ICTR: 33 to 64 lines
constexpr std::uint32_t kSystickCalib = 0x00002904;  // 1 ms at 84 MHz / 8
constexpr std::uint32_t kAircrKey = 0x05FA;

constexpr std::uint32_t kSystickEnable = 1U << 0;
constexpr std::uint32_t kCountFlag = 1U << 16;

constexpr std::uint32_t kDemcrTrace = 1U << 24;

// An exception with bits in SHCSR (System Handler Control and State Register).
struct SystemHandler {
  std::uint8_t number;
  std::uint32_t active_bit;
  std::uint32_t pending_bit;
  std::uint32_t enable_bit;
};

constexpr SystemHandler kHandlers[] = {
    {exc::kMemManage, 1U << 0, 1U << 13, 1U << 16},
    {exc::kBusFault, 1U << 1, 1U << 14, 1U << 17},
    {exc::kUsageFault, 1U << 3, 1U << 12, 1U << 18},
    {exc::kSvCall, 1U << 7, 1U << 15, 0},
    {exc::kDebugMonitor, 1U << 8, 0, 0},
    {exc::kPendSv, 1U << 10, 0, 0},
    {exc::kSysTick, 1U << 11, 0, 0},
};

}  // namespace

SystemControl::SystemControl(Cpu& cpu, Exceptions& exceptions, Scheduler& scheduler,
                             Diagnostics& diagnostics)
    : cpu_(cpu),
      exceptions_(exceptions),
      scheduler_(scheduler),
      diagnostics_(diagnostics),
      id_(scheduler.add(this)) {}

void SystemControl::reset() {
  reset_requested = false;
  systick_control_ = systick_reload_ = systick_stopped_value_ = 0;
  demcr_ = dwt_control_ = cyccnt_held_ = 0;
  scheduler_.set(id_, kNever);
}

void SystemControl::unmodelled(std::uint32_t address, const char* verb) {
  diagnostics_.report(Trouble::kUnmodelled, address,
                      std::string(verb) + " " + hex(address) +
                          " in the private peripheral bus: this register is not modelled");
}

std::uint32_t SystemControl::read_private(std::uint32_t address, std::uint32_t size) {
  const std::uint32_t word = read_word(address & ~3U);
  if (size == 4) return word;
  return (word >> (8 * (address & 3U))) & (size == 1 ? 0xFFU : 0xFFFFU);
}

// A write to the private peripheral bus. Only priority registers (NVIC_IPR at 0x400, SHPR at 0xD18)
// may be written in bytes or halfwords.
void SystemControl::write_private(std::uint32_t address, std::uint32_t value, std::uint32_t size) {
  if (size == 4) return write_word(address, value);
  const std::uint32_t offset = address - 0xE000E000;
  const bool bytes_allowed =
      (offset >= 0x400 && offset < 0x500) || (offset >= 0xD18 && offset < 0xD24);
  if (!bytes_allowed) {
    diagnostics_.report(Trouble::kNarrow, address,
                        "write of " + std::to_string(size) + " bytes to " + hex(address));
  }
  const std::uint32_t shift = 8 * (address & 3U);
  const std::uint32_t mask = (size == 1 ? 0xFFU : 0xFFFFU) << shift;
  const std::uint32_t old = bytes_allowed ? read_word(address & ~3U) : 0U;
  write_word(address & ~3U, (old & ~mask) | ((value << shift) & mask));
}

std::uint32_t SystemControl::read_word(std::uint32_t address) {
  if (address == 0xE0001000) return 0x40000000U | dwt_control_;
  if (address == 0xE0001004) {
    const bool counts = (dwt_control_ & 1U) != 0 && (demcr_ & kDemcrTrace) != 0;
    return counts ? static_cast<std::uint32_t>(cpu_.cycles() - cyccnt_start_) : cyccnt_held_;
  }
  if (address < 0xE000E000 || address >= 0xE000F000) {
    unmodelled(address, "read of");
    return 0;
  }
  const std::uint32_t offset = address - 0xE000E000;
  if (offset >= 0x100 && offset < 0x500) return read_nvic(offset);
  switch (offset) {
    case 0x004:
      return kInterruptLines;
    case 0x008:
      return 0;
    case 0x010: {
      catch_up_systick();
      plan_systick();
      const std::uint32_t value = systick_control_;
      systick_control_ &= ~kCountFlag;
      return value;
    }
    case 0x014:
      return systick_reload_;
    case 0x018:
      return systick_value();
    case 0x01C:
      return kSystickCalib;
    case 0xD00:
      return kCpuId;
    case 0xD04:
      return icsr();
    case 0xD08:
      return cpu_.vtor;
    case 0xD0C:
      return 0xFA050000U | (std::uint32_t{exceptions_.prigroup()} << 8);
    case 0xD10:
      return cpu_.scr;
    case 0xD14:
      return cpu_.ccr;
    case 0xD18:
    case 0xD1C:
    case 0xD20:
      return read_priorities(4 + (offset - 0xD18));
    case 0xD24:
      return shcsr();
    case 0xD28:
      return cpu_.cfsr;
    case 0xD2C:
      return cpu_.hfsr;
    case 0xD30:
      return 0;
    case 0xD34:
      return cpu_.mmfar;
    case 0xD38:
      return cpu_.bfar;
    case 0xD3C:
      return 0;
    case 0xD90:
      return 0x00000800;  // MPU_TYPE: 8 regions, none of them modelled
    case 0xDF0:
      return 0;
    case 0xDFC:
      return demcr_;
    default:
      unmodelled(address, "read of");
      return 0;
  }
}

void SystemControl::write_word(std::uint32_t address, std::uint32_t value) {
  if (address == 0xE0001000) {
    cyccnt_held_ = read_word(0xE0001004);
    dwt_control_ = value & 1U;
    cyccnt_start_ = cpu_.cycles() - cyccnt_held_;
    if ((value & ~1U & 0x0FFFFFFFU) != 0) unmodelled(address, "write of");
    return;
  }
  if (address == 0xE0001004) {
    cyccnt_held_ = value;
    cyccnt_start_ = cpu_.cycles() - value;
    return;
  }
  if (address < 0xE000E000 || address >= 0xE000F000) return unmodelled(address, "write of");
  const std::uint32_t offset = address - 0xE000E000;
  if (offset >= 0x100 && offset < 0x500) return write_nvic(offset, value);
  switch (offset) {
    case 0x010: {
      catch_up_systick();
      const bool was_on = (systick_control_ & kSystickEnable) != 0;
      if (was_on) systick_stopped_value_ = systick_value();
      systick_control_ = (systick_control_ & kCountFlag) | (value & 7U);
      if ((value & kSystickEnable) != 0) return start_systick();
      return plan_systick();
    }
    case 0x014:
      catch_up_systick();
      systick_reload_ = value & 0xFFFFFFU;
      return plan_systick();
    case 0x018:
      systick_control_ &= ~kCountFlag;
      systick_stopped_value_ = 0;
      if ((systick_control_ & kSystickEnable) != 0) start_systick();
      return;
    case 0xD04:
      return write_icsr(value);
    case 0xD08:
      cpu_.vtor = value & 0x3FFFFF80U;
      return;
    case 0xD0C:
      return write_aircr(value);
    case 0xD10:
      cpu_.scr = value & 0x16U;
      exceptions_.sev_on_pend = (value & 0x10U) != 0;
      if ((value & 4U) != 0) {
        diagnostics_.report(Trouble::kUnmodelled, address,
                            "SCR.SLEEPDEEP: wait mode is not modelled");
      }
      return;
    case 0xD14:
      cpu_.ccr = value & 0x31BU;
      return;
    case 0xD18:
    case 0xD1C:
    case 0xD20:
      return write_priorities(4 + (offset - 0xD18), value);
    case 0xD24:
      return write_shcsr(value);
    case 0xD28:
      cpu_.cfsr &= ~value;
      return;
    case 0xD2C:
      cpu_.hfsr &= ~value;
      return;
    case 0xD34:
      cpu_.mmfar = value;
      return;
    case 0xD38:
      cpu_.bfar = value;
      return;
    case 0xDFC:
      cyccnt_held_ = read_word(0xE0001004);
      demcr_ = value & kDemcrTrace;
      cyccnt_start_ = cpu_.cycles() - cyccnt_held_;
      return;
    case 0xF00:
      if ((value & 0x1FFU) < exc::kIrqCount) {
        exceptions_.pend(static_cast<std::uint8_t>(exc::kIrq0 + (value & 0x1FFU)));
      }
      return;
    default:
      return unmodelled(address, "write of");
  }
}

// -- NVIC -------------------------------------------------------------------------------------

std::uint32_t SystemControl::read_nvic(std::uint32_t offset) const {
  if (offset >= 0x400) return read_priorities(16 + (offset - 0x400));
  const std::uint32_t first = (offset & 0x7FU) * 8;
  if (first >= 64) return 0;
  std::uint64_t set = 0;
  switch (offset & 0x780U) {
    case 0x100:
    case 0x180:
      set = exceptions_.enabled_mask();
      break;
    case 0x200:
    case 0x280:
      set = exceptions_.pending_mask();
      break;
    default:
      set = exceptions_.active_mask();
      break;
  }
  return static_cast<std::uint32_t>((set >> exc::kIrq0) >> first);
}

void SystemControl::write_nvic(std::uint32_t offset, std::uint32_t value) {
  if (offset >= 0x400) return write_priorities(16 + (offset - 0x400), value);
  const std::uint32_t first = (offset & 0x7FU) * 8;
  for (std::uint32_t bit = 0; bit < 32 && first + bit < exc::kIrqCount; ++bit) {
    if (((value >> bit) & 1U) == 0) continue;
    const auto number = static_cast<std::uint8_t>(exc::kIrq0 + first + bit);
    switch (offset & 0x780U) {
      case 0x100:
        exceptions_.set_enabled(number, true);
        break;
      case 0x180:
        exceptions_.set_enabled(number, false);
        break;
      case 0x200:
        exceptions_.pend(number);
        break;
      case 0x280:
        exceptions_.unpend(number);
        break;
      default:
        break;
    }
  }
}

std::uint32_t SystemControl::read_priorities(std::uint32_t first) const {
  std::uint32_t value = 0;
  for (std::uint32_t i = 0; i < 4; ++i) {
    if (first + i >= exc::kCount) break;
    value |= static_cast<std::uint32_t>(exceptions_.priority(static_cast<std::uint8_t>(first + i)) &
                                        0xFF)
             << (8 * i);
  }
  return value;
}

// Four priority bytes, of the exceptions from `first` on; 7 to 10 and 13 are reserved.
void SystemControl::write_priorities(std::uint32_t first, std::uint32_t value) {
  for (std::uint32_t i = 0; i < 4; ++i) {
    const std::uint32_t number = first + i;
    const bool reserved = (number >= 7 && number <= 10) || number == 13;
    if (number >= exc::kCount || reserved) continue;
    exceptions_.set_priority(static_cast<std::uint8_t>(number),
                             static_cast<std::uint8_t>(value >> (8 * i)));
  }
}

// -- SCB --------------------------------------------------------------------------------------

std::uint32_t SystemControl::icsr() const {
  std::uint32_t value = cpu_.ipsr();
  const std::uint64_t active = exceptions_.active_mask();
  if ((active & (active - 1)) == 0) value |= 1U << 11;  // RETTOBASE
  const std::uint64_t waiting = exceptions_.pending_mask() & exceptions_.enabled_mask();
  std::uint32_t best = 0;
  int best_priority = Exceptions::kThreadPriority;
  for (std::uint64_t left = waiting; left != 0; left &= left - 1) {
    const auto number = static_cast<std::uint8_t>(__builtin_ctzll(left));
    if (exceptions_.priority(number) < best_priority) {
      best_priority = exceptions_.priority(number);
      best = number;
    }
  }
  value |= best << 12;
  if ((waiting >> exc::kIrq0) != 0) value |= 1U << 22;
  if (exceptions_.pending(exc::kSysTick)) value |= 1U << 26;
  if (exceptions_.pending(exc::kPendSv)) value |= 1U << 28;
  if (exceptions_.pending(exc::kNmi)) value |= 1U << 31;
  return value;
}

void SystemControl::write_icsr(std::uint32_t value) {
  if ((value & (1U << 31)) != 0) exceptions_.pend(exc::kNmi);
  if ((value & (1U << 28)) != 0) exceptions_.pend(exc::kPendSv);
  if ((value & (1U << 27)) != 0) exceptions_.unpend(exc::kPendSv);
  if ((value & (1U << 26)) != 0) exceptions_.pend(exc::kSysTick);
  if ((value & (1U << 25)) != 0) exceptions_.unpend(exc::kSysTick);
}

void SystemControl::write_aircr(std::uint32_t value) {
  if ((value >> 16) != kAircrKey) {
    diagnostics_.report(Trouble::kMisuse, 0xE000ED0C, "write of AIRCR without its key 0x05FA");
    return;
  }
  exceptions_.set_prigroup(static_cast<std::uint8_t>((value >> 8) & 7U));
  if ((value & 5U) != 0) {
    reset_requested = true;
    cpu_.interrupt_run();
  }
}

std::uint32_t SystemControl::shcsr() const {
  std::uint32_t value = 0;
  for (const SystemHandler& handler : kHandlers) {
    if (exceptions_.active(handler.number)) value |= handler.active_bit;
    if (exceptions_.pending(handler.number)) value |= handler.pending_bit;
    if (handler.enable_bit != 0 && exceptions_.enabled(handler.number)) value |= handler.enable_bit;
  }
  return value;
}

void SystemControl::write_shcsr(std::uint32_t value) {
  for (const SystemHandler& handler : kHandlers) {
    exceptions_.set_active(handler.number, (value & handler.active_bit) != 0);
    if (handler.pending_bit != 0) {
      if ((value & handler.pending_bit) != 0) {
        exceptions_.pend(handler.number);
      } else {
        exceptions_.unpend(handler.number);
      }
    }
    if (handler.enable_bit != 0) {
      exceptions_.set_enabled(handler.number, (value & handler.enable_bit) != 0);
    }
  }
}

}  // namespace due_emulator
