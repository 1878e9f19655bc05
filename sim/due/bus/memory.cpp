// The arrays of flash and SRAM, and the address windows in which the processor sees them.
#include "bus/memory.hpp"

#include <algorithm>

namespace due_emulator {

void CodeWindow::open(const Insn& blank, const Insn& past_end) {
  blank_ = blank;
  slots_.assign(size_ / 2 + 1, blank);
  slots_.back() = past_end;
}

// Widens the range that forget_all() must empty.
void CodeWindow::note_decoded(std::uint32_t address) {
  const std::uint32_t index = (address - base_) >> 1;
  lowest_ = std::min(lowest_, index);
  highest_ = std::max(highest_, index);
}

// See memory.hpp.
void CodeWindow::forget(std::uint32_t offset, std::uint32_t size) {
  if (slots_.empty() || offset >= size_) return;
  // A 32-bit instruction may begin one halfword earlier.
  const std::uint32_t first = offset >= 2 ? (offset - 2) / 2 : 0;
  const std::uint32_t last = std::min((offset + size - 1) / 2, size_ / 2 - 1);
  for (std::uint32_t i = first; i <= last; ++i) slots_[i] = blank_;
}

// Empties all slots; only those in the noted range can be decoded.
void CodeWindow::forget_all() {
  if (slots_.empty() || lowest_ > highest_) return;
  std::fill(slots_.begin() + lowest_, slots_.begin() + highest_ + 1, blank_);
  lowest_ = ~0U;
  highest_ = 0;
}

// Flash is erased. The windows are in the order that memory.hpp gives.
Memory::Memory()
    : flash(kFlashSize, 0xFF),
      ram(kRamSize, 0),
      windows{{{kFlashBase, kFlashSize, flash.data()},
               {0, kFlashSize, flash.data()},
               {kRamBase, kRamSize, ram.data()},
               {kRamAlias, kRamAliasSize, ram.data()}}} {}

// Bytes of the SRAM were written: both of its windows forget what was decoded from them.
void Memory::forget_ram_code(std::uint32_t offset, std::uint32_t size) {
  windows[kSram].forget(offset, size);
  windows[kSram0].forget(offset, size);
}

void Memory::forget_flash_code() {
  windows[kFlash].forget_all();
  windows[kFlashMirror].forget_all();
}

// The window that an address, or a decoded instruction, is in; null if none.
CodeWindow* Memory::window_of(std::uint32_t address) {
  for (CodeWindow& window : windows) {
    if (window.holds(address)) return &window;
  }
  return nullptr;
}

CodeWindow* Memory::window_of(const Insn* insn) {
  for (CodeWindow& window : windows) {
    if (window.holds(insn)) return &window;
  }
  return nullptr;
}

}  // namespace due_emulator
