// Conversions, their sequence and the ADC's registers; see adc.hpp.
#include "chip/adc.hpp"

#include <algorithm>
#include <utility>

namespace due_emulator {

namespace {

using access::kBoth;
using access::kRead;
using access::kUnmodelled;
using access::kWrite;

constexpr Register kRegisters[] = {
    {0x00, "ADC_CR", kWrite},
    {0x04, "ADC_MR", kBoth},
    {0x08, "ADC_SEQR1", kBoth | kUnmodelled},
    {0x0C, "ADC_SEQR2", kBoth | kUnmodelled},
    {0x10, "ADC_CHER", kWrite},
    {0x14, "ADC_CHDR", kWrite},
    {0x18, "ADC_CHSR", kRead},
    {0x20, "ADC_LCDR", kRead},
    {0x24, "ADC_IER", kWrite},
    {0x28, "ADC_IDR", kWrite},
    {0x2C, "ADC_IMR", kRead},
    {0x30, "ADC_ISR", kRead},
    {0x3C, "ADC_OVER", kRead},
    {0x40, "ADC_EMR", kBoth},
    {0x44, "ADC_CWR", kBoth},
    {0x48, "ADC_CGR", kBoth},
    {0x4C, "ADC_COR", kBoth},
    {0x50, "ADC_CDR0", kRead},
    {0x54, "ADC_CDR1", kRead},
    {0x58, "ADC_CDR2", kRead},
    {0x5C, "ADC_CDR3", kRead},
    {0x60, "ADC_CDR4", kRead},
    {0x64, "ADC_CDR5", kRead},
    {0x68, "ADC_CDR6", kRead},
    {0x6C, "ADC_CDR7", kRead},
    {0x70, "ADC_CDR8", kRead},
    {0x74, "ADC_CDR9", kRead},
    {0x78, "ADC_CDR10", kRead},
    {0x7C, "ADC_CDR11", kRead},
    {0x80, "ADC_CDR12", kRead},
    {0x84, "ADC_CDR13", kRead},
    {0x88, "ADC_CDR14", kRead},
    {0x8C, "ADC_CDR15", kRead},
    {0x94, "ADC_ACR", kBoth},
    {0xE4, "ADC_WPMR", kBoth | kUnmodelled},
    {0xE8, "ADC_WPSR", kRead | kUnmodelled},
    {0x100, "ADC_RPR", kBoth},
    {0x104, "ADC_RCR", kBoth},
    {0x110, "ADC_RNPR", kBoth},
    {0x114, "ADC_RNCR", kBoth},
    {0x120, "ADC_PTCR", kWrite},
    {0x124, "ADC_PTSR", kRead},
};

// Offsets of the registers that the code below names.
constexpr std::uint32_t kCr = 0x00;
constexpr std::uint32_t kMr = 0x04;
constexpr std::uint32_t kCher = 0x10;
constexpr std::uint32_t kChdr = 0x14;
constexpr std::uint32_t kChsr = 0x18;
constexpr std::uint32_t kLcdr = 0x20;
constexpr std::uint32_t kIer = 0x24;
constexpr std::uint32_t kIdr = 0x28;
constexpr std::uint32_t kImr = 0x2C;
constexpr std::uint32_t kIsr = 0x30;
constexpr std::uint32_t kOver = 0x3C;
constexpr std::uint32_t kEmr = 0x40;
constexpr std::uint32_t kCwr = 0x44;
constexpr std::uint32_t kCgr = 0x48;
constexpr std::uint32_t kCor = 0x4C;
constexpr std::uint32_t kCdr0 = 0x50;
constexpr std::uint32_t kCdr15 = 0x8C;
constexpr std::uint32_t kAcr = 0x94;
constexpr std::uint32_t kRpr = 0x100;
constexpr std::uint32_t kRcr = 0x104;
constexpr std::uint32_t kRnpr = 0x110;
constexpr std::uint32_t kRncr = 0x114;
constexpr std::uint32_t kPtcr = 0x120;
constexpr std::uint32_t kPtsr = 0x124;

// ADC_CR
constexpr std::uint32_t kSwrst = 1U << 0;
constexpr std::uint32_t kStart = 1U << 1;
// ADC_PTCR
constexpr std::uint32_t kRxTen = 1U << 0;
constexpr std::uint32_t kRxTdis = 1U << 1;
constexpr std::uint32_t kAllChannels = 0xFFFF;
// ADC_MR
constexpr std::uint32_t kTriggered = 1U << 0;  // TRGEN
constexpr std::uint32_t kLowResolution = 1U << 4;
constexpr std::uint32_t kSleep = 1U << 5;
constexpr std::uint32_t kFreeRun = 1U << 7;
constexpr std::uint32_t kSequence = 1U << 31;
constexpr Field kPrescal{8, 8};
constexpr Field kStartupField{16, 4};
constexpr Field kTracktim{24, 4};
// STARTUP: periods of the converter's clock from sleep to the first conversion.
constexpr std::uint32_t kStartup[] = {0,   8,   16,  24,  64,  80,  96,  112,
                                      512, 576, 640, 704, 768, 832, 896, 960};
// ADC_ISR
constexpr std::uint32_t kDrdy = 1U << 24;
constexpr std::uint32_t kGovre = 1U << 25;
constexpr std::uint32_t kComparison = 1U << 26;
constexpr std::uint32_t kEndRx = 1U << 27;
constexpr std::uint32_t kRxBuff = 1U << 28;

constexpr std::uint32_t kTag = 1U << 24;         // ADC_EMR
constexpr std::uint32_t kAcrReset = 0x100;       // ADC_ACR.IBCTL = 1
constexpr std::uint32_t kAcrMask = 0x310;        // IBCTL, TSON
constexpr std::uint32_t kEmrMask = 0x010032F3;   // TAG, CMPFILTER, CMPALL, CMPSEL, CMPMODE
constexpr std::uint32_t kCwrMask = 0x0FFF0FFF;   // HIGHTHRES, LOWTHRES
constexpr std::uint32_t kPdcCountMask = 0xFFFF;  // counters of the PDC have 16 bits
// Periods of the converter's clock after the tracking time, TRACKTIM + 1: with the shortest one a
// million samples a second at 21 MHz, as is measured on Dues.
constexpr std::uint64_t kConversion = 20;

}  // namespace

Adc::Adc(System& system)
    : Peripheral(system, "ADC", 0x400C0000, 0x4000, id::kAdc, kRegisters),
      id_(system.scheduler.add(this)) {}

// Also ADC_CR.SWRST; the voltages at the inputs stay.
void Adc::reset() {
  data_ = {};
  mode_ = channels_ = complete_ = overruns_ = interrupts_ = extended_ = last_ = window_ = 0;
  analog_ = kAcrReset;
  transfer_ = {};
  ready_ = overrun_ = awake_ = false;
  running_ = -1;
  system_.scheduler.set(id_, kNever);
  update();
}

// Period of the converter's clock in cycles of MCK: (PRESCAL + 1) times 2.
std::uint64_t Adc::period() const { return (kPrescal.of(mode_) + 1) * 2; }

// ADC_ISR as it is now.
std::uint32_t Adc::flags() const {
  return complete_ | (ready_ ? kDrdy : 0) | (overrun_ ? kGovre : 0) |
         (transfer_.ended ? kEndRx : 0) | (transfer_.full ? kRxBuff : 0);
}

// See adc.hpp. Each conversion also takes the tracking time, ADC_MR.TRACKTIM + 1 periods.
bool Adc::convert_from(int channel, std::uint64_t wait) {
  while (channel < kChannels && !has_bit(channels_, channel)) ++channel;
  running_ = channel < kChannels ? channel : -1;
  if (running_ < 0) return false;
  const std::uint64_t tracking = kTracktim.of(mode_) + 1;
  system_.scheduler.set(id_, system_.now() + (wait + tracking + kConversion) * period());
  return true;
}

// A trigger (ADC_CR.START, or free run): begins with the first enabled channel, after the start-up
// time if the converter slept. A trigger during a sequence is lost.
void Adc::start() {
  if (running_ >= 0) return;
  const bool was_awake = std::exchange(awake_, (mode_ & kSleep) == 0);
  convert_from(0, was_awake ? 0 : kStartup[kStartupField.of(mode_)]);
}

// The end of a conversion: 12 bits (or 10) of the input relative to the reference, and the flags.
void Adc::finish() {
  const auto index = static_cast<std::size_t>(running_);
  // Share of the reference.
  const double share = std::clamp(input_V_[index] / kReference_V, 0.0, 1.0);
  std::uint32_t value = std::min(static_cast<std::uint32_t>(share * 4096.0), 4095U);
  if ((mode_ & kLowResolution) != 0) value >>= 2;
  const std::uint32_t bit = 1U << index;
  // OVRE and GOVRE: the previous value was not read.
  overruns_ |= complete_ & bit;
  overrun_ = overrun_ || ready_;
  complete_ |= bit;
  ready_ = true;
  data_[index] = value;
  last_ = value;
  // LCDR.CHNB.
  if ((extended_ & kTag) != 0) last_ |= static_cast<std::uint32_t>(index) << 12;
}

// The PDC stores the last value, two bytes; that counts as a read of LCDR. Then its next buffer
// runs.
void Adc::move() {
  if (!transfer_.enabled || transfer_.count == 0) return;
  ready_ = false;
  const std::uint32_t at = transfer_.pointer;
  if (!system_.bus.dma_write(at, static_cast<std::uint8_t>(last_)) ||
      !system_.bus.dma_write(at + 1, static_cast<std::uint8_t>(last_ >> 8))) {
    misuse(kRpr, "the PDC would write to " + hex(at) + ", where there is no SRAM");
  }
  transfer_.pointer += 2;
  if (--transfer_.count != 0) return;
  transfer_.ended = true;
  transfer_.full = transfer_.next_count == 0;
  transfer_.pointer = std::exchange(transfer_.next_pointer, 0U);
  transfer_.count = std::exchange(transfer_.next_count, 0U);
}

// The running conversion ends, and the next channel's begins.
void Adc::event(std::uint64_t) {
  if (running_ < 0) return;
  // Without its clock the converter does not advance: try again one period later.
  if (!system_.clocked(id::kAdc)) return system_.scheduler.set(id_, system_.now() + period());
  finish();
  move();
  if (!convert_from(running_ + 1, 0) && (mode_ & kFreeRun) != 0) start();
  update();
}

// Reading a data register (LCDR, CDR) or a status register (ISR, OVER) clears its flags.
std::uint32_t Adc::read(std::uint32_t offset) {
  std::uint32_t value = 0;
  switch (offset) {
    case kMr:
      return mode_;
    case kChsr:
      return channels_;
    case kLcdr:
      ready_ = false;  // reading clears DRDY
      value = last_;
      break;
    case kImr:
      return interrupts_;
    case kIsr:
      value = flags();
      overrun_ = false;
      break;
    case kOver:
      return std::exchange(overruns_, 0U);
    case kEmr:
      return extended_;
    case kCwr:
      return window_;
    case kAcr:
      return analog_;
    case kRpr:
      return transfer_.pointer;
    case kRcr:
      return transfer_.count;
    case kRnpr:
      return transfer_.next_pointer;
    case kRncr:
      return transfer_.next_count;
    case kPtsr:
      return transfer_.enabled ? 1 : 0;
    default:  // a channel's data register; reading clears its EOC
      if (offset < kCdr0 || offset > kCdr15) return 0;
      complete_ &= ~(1U << ((offset - kCdr0) / 4));
      value = data_[(offset - kCdr0) / 4];
      break;
  }
  update();
  return value;
}

// ADC_MR: clock, times and free run.
void Adc::write_mode(std::uint32_t value) {
  if ((value & kTriggered) != 0)
    not_modelled(kMr, "triggers from timers and pins are not modelled");
  if ((value & kSequence) != 0) not_modelled(kMr, "user sequences are not modelled");
  mode_ = value;
  if ((value & kFreeRun) != 0) start();
}

// In free run (FREERUN), enabling a channel starts the conversions.
void Adc::write(std::uint32_t offset, std::uint32_t value) {
  switch (offset) {
    case kCr:
      if ((value & kSwrst) != 0) return reset();
      if ((value & kStart) != 0) start();
      return;
    case kMr:
      return write_mode(value);
    case kCher:
      channels_ |= value & kAllChannels;
      if ((mode_ & kFreeRun) != 0) start();
      return;
    case kChdr:
      channels_ &= ~value;
      return;
    case kIer:
      if ((value & kComparison) != 0) not_modelled(offset, "comparison is not modelled");
      interrupts_ |= value & (kAllChannels | kDrdy | kGovre | kEndRx | kRxBuff);
      break;
    case kIdr:
      interrupts_ &= ~value;
      break;
    case kEmr:
      // The comparison fields only affect COMPE, whose interrupt ADC_IER reports as not modelled.
      extended_ = value & kEmrMask;
      return;
    case kCwr:
      window_ = value & kCwrMask;
      return;
    case kCgr:
    case kCor:
      if (value != 0) not_modelled(offset, "gain and offset are not modelled");
      return;
    case kAcr:
      analog_ = value & kAcrMask;
      return;
    case kRpr:
      transfer_.pointer = value;
      return;
    case kRcr:
      transfer_.count = value & kPdcCountMask;
      if (transfer_.count != 0) transfer_.ended = transfer_.full = false;
      break;
    case kRnpr:
      transfer_.next_pointer = value;
      return;
    case kRncr:
      transfer_.next_count = value & kPdcCountMask;
      if (transfer_.next_count != 0) transfer_.ended = transfer_.full = false;
      break;
    case kPtcr:
      if ((value & kRxTen) != 0) transfer_.enabled = true;
      if ((value & kRxTdis) != 0) transfer_.enabled = false;
      return;
    default:
      return;
  }
  update();
}

}  // namespace due_emulator
