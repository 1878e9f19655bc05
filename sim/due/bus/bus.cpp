// Reads and writes by address: memories first, then bit bands and peripherals; see bus.hpp.
#include "bus/bus.hpp"

#include <algorithm>
#include <cstring>
#include <utility>

#include "cpu/cpu.hpp"

namespace due_emulator {

namespace {

// Bit bands (B3.1): each word there stands for one bit of the SRAM, or of the peripherals'
// registers.
constexpr std::uint32_t kRamBitBand = 0x22000000;
constexpr std::uint32_t kPeripheralBitBand = 0x42000000;
constexpr std::uint32_t kBitBandSize = 0x02000000;

// Address ranges of the processor's memory map.
constexpr std::uint32_t kPeripheralRegionSize = 0x20000000;
constexpr std::uint32_t kPrivateBusBase = 0xE0000000;
constexpr std::uint32_t kPrivateBusSize = 0x00100000;

// The APB bridge costs two cycles more than SRAM in the cycle model.
constexpr std::uint32_t kApbCycles = 2;

// Whether `address` is in the `size` bytes from `base` on.
bool inside(std::uint32_t address, std::uint32_t base, std::uint32_t size) {
  return address - base < size;
}

}  // namespace

// Makes a device answer at the `size` bytes from `base` on.
void Bus::add(std::uint32_t base, std::uint32_t size, Device* device) {
  if (base < kSystemBase) {
    for (std::uint32_t at = base; at < base + size; at += kPeripheralSize) {
      devices_[(at - kPeripheralBase) / kPeripheralSize] = device;
    }
    return;
  }
  for (std::uint32_t at = base; at < base + size; at += kSystemGranule) {
    system_devices_[(at - kSystemBase) / kSystemGranule] = device;
  }
}

void Bus::add_unmodelled(std::uint32_t base, std::uint32_t size, std::string name) {
  unmodelled_.push_back({base, size, std::move(name)});
}

// The device at an address of the peripherals; null if there is none.
Device* Bus::device_at(std::uint32_t address) const {
  if (inside(address, kPeripheralBase, kSystemBase - kPeripheralBase)) {
    return devices_[(address - kPeripheralBase) / kPeripheralSize];
  }
  if (inside(address, kSystemBase, kSystemEnd - kSystemBase)) {
    return system_devices_[(address - kSystemBase) / kSystemGranule];
  }
  return nullptr;
}

// The flash is read or executed at `offset`: the flash controllers check that while one is busy.
void Bus::use_flash(std::uint32_t offset) {
  if (flash_ != nullptr && cpu_->flash_busy) flash_->use(offset);
}

// The byte of SRAM or flash at an address; null if there is no memory that can be accessed so.
// Flash is not written this way.
std::uint8_t* Bus::memory_at(std::uint32_t address, std::uint32_t size, bool for_write) {
  if (inside(address, kRamBase, kRamSize - size + 1))
    return memory_.ram.data() + (address - kRamBase);
  if (inside(address, kRamAlias, kRamAliasSize - size + 1)) {
    return memory_.ram.data() + (address - kRamAlias);
  }
  if (inside(address, kRamAlias + kRamAliasSize, kRamBase - kRamAlias - kRamAliasSize)) {
    diagnostics_.report(Trouble::kUnmapped, address,
                        "access to " + hex(address) + ", where SRAM0 only repeats");
    return memory_.ram.data() + address % kRamAliasSize;
  }
  if (for_write) return nullptr;
  if (inside(address, kFlashBase, kFlashSize - size + 1)) {
    use_flash(address - kFlashBase);
    return memory_.flash.data() + (address - kFlashBase);
  }
  if (inside(address, 0, kFlashSize - size + 1)) {
    use_flash(address);
    return memory_.flash.data() + address;
  }
  return nullptr;
}

// An access to an address where nothing is: reported, and a precise BusFault. `verb` is "read of"
// or "write of".
void Bus::fail(std::uint32_t address, const char* verb) {
  diagnostics_.report(Trouble::kUnmapped, address,
                      std::string(verb) + " " + hex(address) + ", where there is nothing");
  throw Fault{exc::kBusFault, cfsr::kPrecisErr, address, true};
}

// Only privileged code may use the private peripheral bus; otherwise a BusFault.
void Bus::check_private(std::uint32_t address, const char* verb) {
  if (cpu_->privileged()) return;
  diagnostics_.report(Trouble::kUnmapped, address,
                      std::string(verb) + " " + hex(address) + " by unprivileged code");
  throw Fault{exc::kBusFault, cfsr::kPrecisErr, address, true};
}

// A load of 1, 2 or 4 bytes from any address. An unaligned one is reported and split into bytes.
std::uint32_t Bus::read(std::uint32_t address, std::uint32_t size) {
  if ((address & (size - 1)) != 0) {
    diagnostics_.report(Trouble::kUnaligned, address,
                        "read of " + std::to_string(size) + " bytes from " + hex(address));
    std::uint32_t value = 0;
    for (std::uint32_t i = 0; i < size; ++i) value |= read(address + i, 1) << (8 * i);
    return value;
  }
  if (const std::uint8_t* at = memory_at(address, size, false)) {
    std::uint32_t value = 0;
    std::memcpy(&value, at, size);
    return value;
  }
  if (inside(address, kRamBitBand, kBitBandSize)) {
    // Bit-banding: each byte of SRAM has 32 bytes here, each bit 4, so bits 2 to 4 of the offset
    // are the number of the bit.
    const std::uint32_t offset = address - kRamBitBand;
    return (read(kRamAlias + offset / 32, 1) >> ((offset >> 2) & 7U)) & 1U;
  }
  if (inside(address, kPeripheralBitBand, kBitBandSize)) {
    // Registers are read as words, so the number of the bit has five bits.
    const std::uint32_t offset = address - kPeripheralBitBand;
    const std::uint32_t target = kPeripheralBase + ((offset / 32) & ~3U);
    return (read_peripheral(target, 4) >> ((offset >> 2) & 31U)) & 1U;
  }
  if (inside(address, kPeripheralBase, kPeripheralRegionSize))
    return read_peripheral(address, size);
  if (inside(address, kPrivateBusBase, kPrivateBusSize) && private_bus_ != nullptr) {
    check_private(address, "read of");
    return private_bus_->read_private(address, size);
  }
  fail(address, "read of");
}

// A store of 1, 2 or 4 bytes to any address. A word in a bit band changes one bit of its target.
void Bus::write(std::uint32_t address, std::uint32_t value, std::uint32_t size) {
  if ((address & (size - 1)) != 0) {
    diagnostics_.report(Trouble::kUnaligned, address,
                        "write of " + std::to_string(size) + " bytes to " + hex(address));
    for (std::uint32_t i = 0; i < size; ++i) write(address + i, (value >> (8 * i)) & 0xFFU, 1);
    return;
  }
  if (std::uint8_t* at = memory_at(address, size, true)) {
    std::memcpy(at, &value, size);
    const auto offset = static_cast<std::uint32_t>(at - memory_.ram.data());
    if (memory_.ram_code[offset / 64] != 0) memory_.forget_ram_code(offset, size);
    return;
  }
  // Bit-banding, as in read().
  if (inside(address, kRamBitBand, kBitBandSize)) {
    const std::uint32_t offset = address - kRamBitBand;
    const std::uint32_t target = kRamAlias + offset / 32;
    const std::uint32_t bit = 1U << ((offset >> 2) & 7U);
    const std::uint32_t old = read(target, 1);
    return write(target, (value & 1U) != 0 ? old | bit : old & ~bit, 1);
  }
  if (inside(address, kPeripheralBitBand, kBitBandSize)) {
    const std::uint32_t offset = address - kPeripheralBitBand;
    const std::uint32_t target = kPeripheralBase + ((offset / 32) & ~3U);
    const std::uint32_t bit = 1U << ((offset >> 2) & 31U);
    const std::uint32_t old = read_peripheral(target, 4);
    return write_peripheral(target, (value & 1U) != 0 ? old | bit : old & ~bit, 4);
  }
  if (inside(address, kPeripheralBase, kPeripheralRegionSize))
    return write_peripheral(address, value, size);
  if (rehearsal_.on) return;
  if (inside(address, kPrivateBusBase, kPrivateBusSize) && private_bus_ != nullptr) {
    check_private(address, "write of");
    return private_bus_->write_private(address, value, size);
  }
  if (inside(address, kFlashBase, kFlashSize) && flash_ != nullptr) {
    return flash_->latch(address - kFlashBase, value, size);
  }
  fail(address, "write of");
}

// The name of the register at an address, for messages; "" if no peripheral is there.
std::string Bus::name_of(std::uint32_t address) const {
  if (const Device* device = device_at(address)) return device->name_of(address & ~3U);
  for (const Unmodelled& part : unmodelled_) {
    if (!inside(address, part.base, part.size)) continue;
    char offset[16];
    std::snprintf(offset, sizeof offset, "+0x%x", static_cast<unsigned>(address - part.base));
    return hex(address) + " " + part.name + offset;
  }
  return {};
}

std::uint32_t Bus::outside_bits(std::uint32_t address) const {
  const Device* device = device_at(address);
  return device == nullptr ? 0 : device->outside_bits(address & ~3U);
}

// Reports an access to a peripheral that the model lacks. Returns false if there is no such
// peripheral.
bool Bus::report_unmodelled(std::uint32_t address, const char* verb) {
  const std::string name = name_of(address);
  if (name.empty()) return false;
  diagnostics_.report(Trouble::kUnmodelled, address,
                      std::string(verb) + " " + name + ": this peripheral is not modelled");
  return true;
}

// A load from a peripheral: takes its cycles, and is noted for the detection of wait loops. In a
// rehearsal the first read gives the rehearsed value, and the second ends it.
std::uint32_t Bus::read_peripheral(std::uint32_t address, std::uint32_t size) {
  if (rehearsal_.on) {
    if (std::exchange(rehearsal_.has_read, true)) throw RehearsalEnds{};
    return rehearsal_.value;
  }
  cpu_->stall(kApbCycles);
  const std::uint32_t value = read_device(address, size);
  if (diagnostics_.strict(Trouble::kWait)) waits.read(*cpu_, address, value);
  return value;
}

// Reads the device's register; a narrow read is reported, and gives its bytes of the word.
std::uint32_t Bus::read_device(std::uint32_t address, std::uint32_t size) {
  Device* device = device_at(address);
  if (device == nullptr) {
    if (report_unmodelled(address, "read of")) return 0;
    fail(address, "read of");
  }
  if (size == 4) return device->read_register(address);
  diagnostics_.report(Trouble::kNarrow, address,
                      "read of " + std::to_string(size) + " bytes from " + hex(address) +
                          ": registers of peripherals take words");
  return device->read_register(address & ~3U) >> (8 * (address & 3U)) &
         (size == 1 ? 0xFFU : 0xFFFFU);
}

// A write to a peripheral's register. A rehearsal of an instruction writes nothing. A narrow write
// is reported, and reaches the register as a word.
void Bus::write_peripheral(std::uint32_t address, std::uint32_t value, std::uint32_t size) {
  if (rehearsal_.on) return;
  cpu_->stall(kApbCycles);
  if (diagnostics_.strict(Trouble::kWait)) waits.write(*cpu_, address);
  Device* device = device_at(address);
  if (device == nullptr) {
    if (report_unmodelled(address, "write of")) return;
    fail(address, "write of");
  }
  if (size != 4) {
    diagnostics_.report(Trouble::kNarrow, address,
                        "write of " + std::to_string(size) + " bytes to " + hex(address) +
                            ": registers of peripherals take words");
    value <<= 8 * (address & 3U);
  }
  device->write_register(address & ~3U, value);
}

// One byte for a PDC, from SRAM or flash; false if there is neither.
bool Bus::dma_read(std::uint32_t address, std::uint8_t& value) const {
  if (inside(address, kRamBase, kRamSize)) {
    value = memory_.ram[address - kRamBase];
  } else if (inside(address, kRamAlias, kRamAliasSize)) {
    value = memory_.ram[address - kRamAlias];
  } else if (inside(address, kFlashBase, kFlashSize)) {
    value = memory_.flash[address - kFlashBase];
  } else {
    return false;
  }
  return true;
}

// One byte from a PDC into SRAM; code that was decoded from there is forgotten. False: no SRAM
// there.
bool Bus::dma_write(std::uint32_t address, std::uint8_t value) {
  std::uint32_t offset = address - kRamBase;
  if (offset >= kRamSize) offset = address - kRamAlias;
  if (offset >= kRamSize || (address < kRamBase && offset >= kRamAliasSize)) return false;
  memory_.ram[offset] = value;
  if (memory_.ram_code[offset / 64] != 0) memory_.forget_ram_code(offset, 1);
  return true;
}

}  // namespace due_emulator
