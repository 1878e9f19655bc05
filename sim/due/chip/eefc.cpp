// Flash commands, their duration and their errors, and the registers; see eefc.hpp.
#include "chip/eefc.hpp"

#include <algorithm>
#include <cstring>

namespace due_emulator {

namespace {

using access::kBoth;
using access::kRead;
using access::kWrite;

constexpr Register kRegisters[] = {
    {0x00, "EEFC_FMR", kBoth},
    {0x04, "EEFC_FCR", kWrite},
    {0x08, "EEFC_FSR", kRead},
    {0x0C, "EEFC_FRR", kRead},
};

// Offsets of the registers that the code below names.
constexpr std::uint32_t kFmr = 0x00;
constexpr std::uint32_t kFcr = 0x04;
constexpr std::uint32_t kFsr = 0x08;

// EEFC_FCR.FCMD: commands (18.4.3)
constexpr std::uint32_t kGetd = 0x00;
constexpr std::uint32_t kWp = 0x01;    // write page
constexpr std::uint32_t kWpl = 0x02;   // write page and lock
constexpr std::uint32_t kEwp = 0x03;   // erase page and write
constexpr std::uint32_t kEwpl = 0x04;  // erase page, write and lock
constexpr std::uint32_t kEa = 0x05;    // erase all
constexpr std::uint32_t kSlb = 0x08;   // set, clear, get lock bits
constexpr std::uint32_t kClb = 0x09;
constexpr std::uint32_t kGlb = 0x0A;
constexpr std::uint32_t kSgpb = 0x0B;  // set, clear, get GPNVM bits
constexpr std::uint32_t kCgpb = 0x0C;
constexpr std::uint32_t kGgpb = 0x0D;

// EEFC_FMR
constexpr std::uint32_t kFmrMask = 0x01010F01;  // FAM, SCOD, FWS, FRDY
constexpr std::uint32_t kFrdyInterrupt = 1U << 0;
constexpr Field kFws{8, 4};   // EEFC_FMR: wait states
constexpr Field kFcmd{0, 8};  // EEFC_FCR: command, argument and key
constexpr Field kFarg{8, 16};
constexpr Field kFkey{24, 8};

// EEFC_FSR
constexpr std::uint32_t kFrdy = 1U << 0;
constexpr std::uint32_t kFcmde = 1U << 1;
constexpr std::uint32_t kFlocke = 1U << 2;
constexpr std::uint32_t kKey = 0x5A;          // EEFC_FCR.FKEY
constexpr std::uint32_t kCommandMask = 0x0F;  // of command_
constexpr std::uint32_t kBusyMark = 0x80;     // distinguishes "busy with command 0" from idle

}  // namespace

Flash::Flash(System& system) : system_(system) {}

// A plane began or ended programming; the processor then reads the flash by way of use().
void Flash::update_busy() { system_.cpu.flash_busy = planes_[0]->busy() || planes_[1]->busy(); }

// The processor reads the flash at `offset`. If that plane is being programmed, this is reported,
// and the processor waits for the plane.
void Flash::use(std::uint32_t offset) {
  FlashController& plane = plane_at(offset);
  if (!plane.busy()) return;
  system_.diagnostics.report(Trouble::kMisuse, kFlashBase + offset,
                             "flash at " + hex(kFlashBase + offset) +
                                 " is read or executed while its plane is being programmed");
  const std::uint64_t ready = plane.ready_cycle();
  if (ready > system_.now()) system_.cpu.stall(ready - system_.now());
}

// A store to the flash's addresses goes to the page latches of its plane, not to the flash.
void Flash::latch(std::uint32_t offset, std::uint32_t value, std::uint32_t size) {
  if (size != 4) {
    system_.diagnostics.report(
        Trouble::kNarrow, kFlashBase + offset,
        "write of " + std::to_string(size) + " bytes to the page latches, which take words");
  }
  plane_at(offset).latch(offset, value);
}

// EFC0 has the lower plane, EFC1 the upper one.
FlashController::FlashController(System& system, Flash& flash, int index)
    : Peripheral(system, index == 0 ? "EFC0" : "EFC1", index == 0 ? 0x400E0A00U : 0x400E0C00U,
                 0x200, kAlwaysClocked, kRegisters),
      flash_(flash),
      index_(index),
      id_(system.scheduler.add(this)) {
  latches_.fill(0xFF);
  flash.attach(index, this);
}

// A reset in the middle of programming leaves the page half done.
void FlashController::reset() {
  cut();
  mode_ = errors_ = 0;
  result_count_ = result_next_ = 0;
  set_wait_states(0);
  update_irq();
}

// EEFC_FMR.FWS: wait states of a read of this plane.
void FlashController::set_wait_states(std::uint32_t count) {
  system_.flash_wait_states[static_cast<std::size_t>(index_)] = count;
  // Code runs from the lower plane: it decides for the cycle model.
  if (index_ == 0) system_.cpu.set_flash_wait_states(count);
}

// The bytes of a page of this plane.
std::uint8_t* FlashController::page_bytes(std::uint32_t page) const {
  return system_.memory.flash.data() + static_cast<std::uint32_t>(index_) * kPlaneSize +
         page * kPage;
}

// A word for the page that the next command writes; the latches of one page serve all of them.
void FlashController::latch(std::uint32_t offset, std::uint32_t value) {
  ++stores_;
  if (busy()) {
    system_.diagnostics.report(Trouble::kMisuse, kFlashBase + offset,
                               "write to the page latches while the plane is being programmed");
  }
  std::memcpy(latches_.data() + (offset % kPage & ~3U), &value, 4);
}

// See eefc.hpp. First the page (or the plane) is erased from its beginning on, then the latches are
// written; writing can only clear bits.
void FlashController::apply(BoardTime passed) {
  const std::uint32_t code = command_ & kCommandMask;
  const bool writes = code == kWp || code == kWpl || code == kEwp || code == kEwpl;
  const BoardTime write = end_ - begin_ - erase_;
  std::uint8_t* page = code == kEa ? page_bytes(0) : page_bytes(page_);
  const std::uint64_t size = code == kEa ? kPlaneSize : kPage;
  if (erase_ != 0) {
    const std::uint64_t erased = std::min(passed, erase_) * (size / 4) / erase_ * 4;
    std::memset(page, 0xFF, erased);
  }
  if (writes && passed > erase_) {
    const std::uint64_t written = (passed - erase_) * (kPage / 4) / write * 4;
    for (std::uint64_t i = 0; i < written; ++i) page[i] &= latches_[i];
  }
  if (erase_ != 0 || writes) system_.cpu.flush_flash_code();
}

// See eefc.hpp: the command that runs ends here, with the flash half done.
void FlashController::cut() {
  if (!busy()) return;
  apply(std::min(system_.board_now(), end_) - begin_);
  command_ = 0;
  latches_.fill(0xFF);
  flash_.update_busy();
  system_.scheduler.set(id_, kNever);
}

// What the ERASE pin does: the plane is empty, and no region is locked.
void FlashController::erase_all() {
  std::memset(page_bytes(0), 0xFF, kPlaneSize);
  locks_ = 0;
  system_.cpu.flush_flash_code();
}

// Schedules event() for the end of the command that runs.
void FlashController::plan() {
  system_.scheduler.set(id_, busy() ? system_.clock.cycle_at(end_) : kNever);
}

void FlashController::update_irq() {
  system_.set_irq(index_ == 0 ? id::kEfc0 : id::kEfc1, !busy() && (mode_ & kFrdyInterrupt) != 0);
}

// The running command ends: the flash has its new content.
void FlashController::event(std::uint64_t) {
  if (!busy()) return;
  if (system_.board_now() < end_) return plan();
  apply(end_ - begin_);
  const std::uint32_t code = command_ & kCommandMask;
  if (code == kWpl || code == kEwpl) locks_ |= 1U << (page_ * kPage / kLockRegion);
  if (code <= kEa && code != kGetd) ++writes_;
  command_ = 0;
  latches_.fill(0xFF);
  flash_.update_busy();
  update_irq();
}

// EEFC_FMR, EEFC_FSR and EEFC_FRR.
std::uint32_t FlashController::read(std::uint32_t offset) {
  switch (offset) {
    case kFmr:
      return mode_;
    case kFsr: {  // reading clears the errors
      const std::uint32_t value = (busy() ? 0U : kFrdy) | errors_;
      errors_ = 0;
      return value;
    }
    default:  // EEFC_FRR: the results of a command, one word per read
      if (result_next_ >= result_count_) return 0;
      return results_[result_next_++];
  }
}

// EEFC_FCR is a command. EEFC_FMR sets the wait states, which must be enough for the master clock.
void FlashController::write(std::uint32_t offset, std::uint32_t value) {
  if (offset == kFcr) return command(value);
  if (busy()) misuse(offset, "write while the plane is being programmed");
  mode_ = value & kFmrMask;
  update_irq();
  const std::uint32_t wait_states = kFws.of(value);
  set_wait_states(wait_states);
  const std::uint32_t mck_Hz = system_.clock.mck_Hz();
  if (mck_Hz > flash_limit_Hz(wait_states)) {
    misuse(offset, "FWS = " + std::to_string(wait_states) + " is too few wait states for " +
                       std::to_string(mck_Hz) + " Hz");
  }
}

// Appends a word to what EEFC_FRR will give.
void FlashController::result(std::uint32_t word) {
  results_[result_count_++ % results_.size()] = word;
}

// Code that runs from a plane cannot program it: the fetch behind the command would already fail.
void FlashController::check_caller() const {
  const std::uint32_t pc = system_.cpu.pc();
  const std::uint32_t offset = pc >= kFlashBase ? pc - kFlashBase : pc;
  if (offset >= kFlashSize || offset / kPlaneSize != static_cast<std::uint32_t>(index_)) return;
  misuse(kFcr, "a plane is programmed by code that runs from it");
  system_.cpu.stall(ready_cycle() - system_.now());
}

// Starts a command that takes time: `erase` and then `write`. A locked region sets FLOCKE instead.
void FlashController::start(std::uint32_t code, std::uint32_t page, BoardTime erase,
                            BoardTime write) {
  const std::uint32_t region = page * kPage / kLockRegion;
  const bool locked = code == kEa ? locks_ != 0 : has_bit(locks_, region);
  if (code <= kEa && locked) {
    errors_ |= kFlocke;
    return;
  }
  if (code <= kEa && kFws.of(mode_) < kWriteWaitStates) {
    misuse(kFcr, "flash is written with FWS = " + std::to_string(kFws.of(mode_)) +
                     "; the errata ask for 6");
  }
  command_ = code | kBusyMark;
  page_ = page;
  begin_ = system_.board_now();
  erase_ = erase;
  end_ = begin_ + erase + write;
  flash_.update_busy();
  plan();
  update_irq();
  check_caller();
}

// EEFC_FCR: key, command and argument (a page, a lock region's page or a GPNVM bit).
void FlashController::command(std::uint32_t value) {
  ++stores_;
  const std::uint32_t code = kFcmd.of(value);
  const std::uint32_t argument = kFarg.of(value);
  if (kFkey.of(value) != kKey) {
    errors_ |= kFcmde;
    return misuse(kFcr, "command without the key 0x5A");
  }
  if (busy()) return misuse(kFcr, "command while EEFC_FSR.FRDY is 0");
  errors_ = 0;
  result_count_ = result_next_ = 0;
  switch (code) {
    // Flash descriptor: interface, size, page size, one plane and its size, lock bits and the size
    // of each region.
    case kGetd:
      for (const std::uint32_t word : {0x000F0940U, kPlaneSize, kPage, 1U, kPlaneSize, 16U})
        result(word);
      for (int i = 0; i < 10; ++i) result(kLockRegion);
      return;
    case kWp:
    case kWpl:
    case kEwp:
    case kEwpl:
      if (argument >= kPages) {
        errors_ |= kFcmde;
        return misuse(kFcr, "page " + std::to_string(argument) + " is outside of the plane");
      }
      return start(code, argument, code >= kEwp ? kEraseTime : 0, kWriteTime);
    case kEa:
      return start(code, 0, kEraseAllTime, 0);
    case kSlb:
      locks_ |= 1U << (argument * kPage / kLockRegion & 31U);
      return;
    case kClb:
      locks_ &= ~(1U << (argument * kPage / kLockRegion & 31U));
      return;
    case kGlb:
      return result(locks_);
    case kSgpb:
    case kCgpb:
      if (argument > 2) {  // there are three GPNVM bits
        errors_ |= kFcmde;
        return;
      }
      flash_.gpnvm =
          code == kSgpb ? flash_.gpnvm | (1U << argument) : flash_.gpnvm & ~(1U << argument);
      return;
    case kGgpb:
      return result(flash_.gpnvm);
    default:
      errors_ |= kFcmde;
      return not_modelled(kFcr, "command " + std::to_string(code) + " is not modelled");
  }
}

}  // namespace due_emulator
