// Flash, SRAM and the decoded copies of the code in them.
#pragma once

#include <array>
#include <cstdint>
#include <cstring>
#include <memory>
#include <vector>

#include "cpu/insn.hpp"

namespace due_emulator {

inline constexpr std::uint32_t kFlashBase = 0x00080000;
inline constexpr std::uint32_t kFlashSize = 512 * 1024;
inline constexpr std::uint32_t kPlaneSize = 256 * 1024;
inline constexpr std::uint32_t kRomBase = 0x00100000;
// SRAM0 (64 KiB) repeats below 0x20080000 and SRAM1 (32 KiB) begins there, which makes 96 KiB in a
// row from 0x20070000 on. SRAM0 also stands at its own base; its repetitions in between are the
// chip's too, but no program has business there: strict mode stops, lenient mode goes on in SRAM0.
inline constexpr std::uint32_t kRamBase = 0x20070000;
inline constexpr std::uint32_t kRamSize = 96 * 1024;
inline constexpr std::uint32_t kRamAlias = 0x20000000;
inline constexpr std::uint32_t kRamAliasSize = 64 * 1024;

// Decoded instructions of one window on a memory. Several windows may show the same bytes.
class CodeWindow {
 public:
  CodeWindow(std::uint32_t base, std::uint32_t size, const std::uint8_t* bytes)
      : base_(base), size_(size), bytes_(bytes) {}

  bool holds(std::uint32_t address) const { return address - base_ < size_; }
  bool holds(const Insn* insn) const {
    return !slots_.empty() && insn >= slots_.data() && insn < slots_.data() + slots_.size();
  }
  std::uint32_t base() const { return base_; }
  std::uint32_t size() const { return size_; }
  const std::uint8_t* bytes() const { return bytes_; }
  // Null until the window is first executed.
  Insn* slots() { return slots_.empty() ? nullptr : slots_.data(); }
  Insn* slot(std::uint32_t address) { return slots_.data() + ((address - base_) >> 1); }
  std::uint32_t address_of(const Insn* insn) const {
    return base_ + 2 * static_cast<std::uint32_t>(insn - slots_.data());
  }

  // Makes every slot `blank`; one more stands behind the end for code that runs off it.
  void open(const Insn& blank, const Insn& past_end);
  // Forgets what was decoded from the bytes [offset, offset + size).
  void forget(std::uint32_t offset, std::uint32_t size);
  void forget_all();
  void note_decoded(std::uint32_t address);

 private:
  std::uint32_t base_;
  std::uint32_t size_;
  const std::uint8_t* bytes_;
  Insn blank_{};
  std::vector<Insn> slots_;
  std::uint32_t lowest_ = ~0U;  // decoded slots lie in [lowest_, highest_]
  std::uint32_t highest_ = 0;
};

class Memory {
 public:
  Memory();

  std::vector<std::uint8_t> flash;
  std::vector<std::uint8_t> ram;

  // One flag for every 64 bytes of RAM that holds decoded code.
  std::array<std::uint8_t, kRamSize / 64> ram_code{};

  // Flash, its mirror at 0, SRAM, SRAM0 at its own base.
  enum Window : std::uint8_t { kFlash, kFlashMirror, kSram, kSram0, kWindows };
  std::array<CodeWindow, kWindows> windows;

  void forget_ram_code(std::uint32_t offset, std::uint32_t size);
  void forget_flash_code();
  CodeWindow* window_of(std::uint32_t address);
  CodeWindow* window_of(const Insn* insn);
};

}  // namespace due_emulator
