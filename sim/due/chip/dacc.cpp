// Conversions of the DAC from its FIFO, and its registers; see dacc.hpp.
#include "chip/dacc.hpp"

namespace due_emulator {

namespace {

using access::kBoth;
using access::kRead;
using access::kUnmodelled;
using access::kWrite;

constexpr Register kRegisters[] = {
    {0x00, "DACC_CR", kWrite},
    {0x04, "DACC_MR", kBoth},
    {0x10, "DACC_CHER", kWrite},
    {0x14, "DACC_CHDR", kWrite},
    {0x18, "DACC_CHSR", kRead},
    {0x20, "DACC_CDR", kWrite},
    {0x24, "DACC_IER", kWrite},
    {0x28, "DACC_IDR", kWrite},
    {0x2C, "DACC_IMR", kRead},
    {0x30, "DACC_ISR", kRead},
    {0x94, "DACC_ACR", kBoth},
    {0xE4, "DACC_WPMR", kBoth | kUnmodelled},
    {0xE8, "DACC_WPSR", kRead | kUnmodelled},
    {0x108, "DACC_TPR", kBoth | kUnmodelled},
    {0x10C, "DACC_TCR", kBoth | kUnmodelled},
    {0x118, "DACC_TNPR", kBoth | kUnmodelled},
    {0x11C, "DACC_TNCR", kBoth | kUnmodelled},
    {0x120, "DACC_PTCR", kWrite | kUnmodelled},
    {0x124, "DACC_PTSR", kRead | kUnmodelled},
};

// Offsets of the registers that the code below names.
constexpr std::uint32_t kCr = 0x00;
constexpr std::uint32_t kMr = 0x04;
constexpr std::uint32_t kCher = 0x10;
constexpr std::uint32_t kChdr = 0x14;
constexpr std::uint32_t kChsr = 0x18;
constexpr std::uint32_t kCdr = 0x20;
constexpr std::uint32_t kIer = 0x24;
constexpr std::uint32_t kIdr = 0x28;
constexpr std::uint32_t kImr = 0x2C;
constexpr std::uint32_t kIsr = 0x30;
constexpr std::uint32_t kAcr = 0x94;

constexpr std::uint32_t kSwrst = 1U << 0;   // DACC_CR
constexpr std::uint32_t kBothChannels = 3;  // DACC_CHER
// DACC_MR
constexpr std::uint32_t kTriggered = 1U << 0;  // TRGEN
constexpr std::uint32_t kWord = 1U << 4;       // DACC_CDR takes two values at once
constexpr std::uint32_t kTag = 1U << 20;       // bits 12 and 13 of a value are its channel
constexpr unsigned kUserSel = 16;              // otherwise this field is
constexpr std::uint32_t kMrMask = 0x3F33FF7F;  // all fields of DACC_MR
constexpr std::uint32_t kAcrMask = 0x30F;      // IBCTLCH0, IBCTLCH1, IBCTLDACCORE
// DACC_ISR
constexpr std::uint32_t kTxRdy = 1U << 0;
constexpr std::uint32_t kEoc = 1U << 1;
constexpr std::uint32_t kPdcFlags = 3U << 2;  // ENDTX, TXBUFE
constexpr std::size_t kQueue = 4;             // values in the FIFO
// A conversion takes 25 periods of MCK / 2.
constexpr std::uint64_t kCycles = 50;
// Outputs go from a sixth to five sixths of the reference, 0.55 to 2.75 V on a Due.
constexpr double kReference_V = 3.3;

}  // namespace

Dacc::Dacc(System& system)
    : Peripheral(system, "DACC", 0x400C8000, 0x4000, id::kDacc, kRegisters),
      id_(system.scheduler.add(this)) {}

void Dacc::reset() {
  waiting_.clear();
  code_ = {};
  mode_ = channels_ = interrupts_ = analog_ = 0;
  complete_ = false;
  system_.scheduler.set(id_, kNever);
  update();
}

// See dacc.hpp. Codes 0 to 4095 give one sixth to five sixths of the reference.
double Dacc::output_V(int channel) const {
  const auto index = static_cast<std::size_t>(channel);
  if (!has_bit(channels_, index)) return 0.0;
  return kReference_V * (1.0 + 4.0 * code_.at(index) / 4095.0) / 6.0;
}

// DACC_ISR: TXRDY (room in the FIFO) and EOC.
std::uint32_t Dacc::flags() const {
  const bool room = channels_ != 0 && waiting_.size() < kQueue;
  return (room ? kTxRdy : 0) | (complete_ ? kEoc : 0);
}

// Puts a value of 12 bits into the FIFO.
void Dacc::queue(std::uint32_t half_word) {
  const std::size_t channel = ((mode_ & kTag) != 0 ? half_word >> 12 : mode_ >> kUserSel) & 1U;
  if (!has_bit(channels_, channel)) {
    return misuse(kCdr, "value for channel " + std::to_string(channel) + ", which is off");
  }
  if (waiting_.size() == kQueue) return misuse(kCdr, "write while DACC_ISR.TXRDY is 0");
  waiting_.push_back({channel, half_word & 0xFFFU});
  if (waiting_.size() == 1) system_.scheduler.set(id_, system_.now() + kCycles);
}

// A conversion ends: its value is at the output, and the next one begins.
void Dacc::event(std::uint64_t) {
  if (waiting_.empty()) return;
  code_[waiting_.front().channel] = waiting_.front().code;
  waiting_.pop_front();
  complete_ = true;
  if (!waiting_.empty()) system_.scheduler.set(id_, system_.now() + kCycles);
  update();
}

// Reading DACC_ISR clears EOC.
std::uint32_t Dacc::read(std::uint32_t offset) {
  switch (offset) {
    case kMr:
      return mode_;
    case kChsr:
      return channels_;
    case kImr:
      return interrupts_;
    case kIsr: {
      const std::uint32_t value = flags();
      complete_ = false;
      update();
      return value;
    }
    case kAcr:
      return analog_;
    default:
      return 0;
  }
}

// A write to DACC_CDR queues one value, or with WORD two.
void Dacc::write(std::uint32_t offset, std::uint32_t value) {
  switch (offset) {
    case kCr:
      if ((value & kSwrst) != 0) return reset();
      return;
    case kMr:
      if ((value & kTriggered) != 0) not_modelled(offset, "triggers are not modelled");
      mode_ = value & kMrMask;
      return;
    case kCher:
      channels_ |= value & kBothChannels;
      break;
    case kChdr:
      channels_ &= ~value;
      break;
    case kCdr:
      queue(value & 0xFFFFU);
      if ((mode_ & kWord) != 0) queue(value >> 16);
      break;
    case kIer:
      if ((value & kPdcFlags) != 0) not_modelled(offset, "the PDC is not modelled");
      interrupts_ |= value & (kTxRdy | kEoc);
      break;
    case kIdr:
      interrupts_ &= ~value;
      break;
    case kAcr:
      analog_ = value & kAcrMask;
      return;
    default:
      return;
  }
  update();
}

}  // namespace due_emulator
