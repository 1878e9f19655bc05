// The address map behind the fast paths of the processor: aliases, bit bands, peripherals, faults.
#pragma once

#include <array>
#include <cstdint>
#include <string>
#include <vector>

#include "bus/diagnostics.hpp"
#include "bus/memory.hpp"
#include "bus/wait_loops.hpp"

namespace due_emulator {

class Cpu;

// A peripheral with registers, which are words: `address` is a multiple of 4.
class Device {
 public:
  virtual ~Device() = default;
  virtual std::uint32_t read_register(std::uint32_t address) = 0;
  virtual void write_register(std::uint32_t address, std::uint32_t value) = 0;
  // The register's name, for messages.
  virtual std::string name_of(std::uint32_t address) const { return hex(address); }
  // The bits of the register that something outside of the chip, or a slow clock, can change.
  virtual std::uint32_t outside_bits(std::uint32_t) const { return 0; }
};

// The private peripheral bus takes bytes and halfwords in places.
class PrivateBus {
 public:
  virtual ~PrivateBus() = default;
  virtual std::uint32_t read_private(std::uint32_t address, std::uint32_t size) = 0;
  virtual void write_private(std::uint32_t address, std::uint32_t value, std::uint32_t size) = 0;
};

// The flash controllers, as far as accesses to flash concern them.
class FlashPort {
 public:
  virtual ~FlashPort() = default;
  // A read or a fetch at `offset` while flash_busy is set.
  virtual void use(std::uint32_t offset) = 0;
  // A write into the page latches.
  virtual void latch(std::uint32_t offset, std::uint32_t value, std::uint32_t size) = 0;
};

// Thrown by the second read of a peripheral in a rehearsal; see rehearsal.cpp.
struct RehearsalEnds {};

class Bus {
 public:
  Bus(Memory& memory, Diagnostics& diagnostics) : memory_(memory), diagnostics_(diagnostics) {}

  void connect(Cpu* cpu, PrivateBus* private_bus, FlashPort* flash) {
    cpu_ = cpu;
    private_bus_ = private_bus;
    flash_ = flash;
  }
  void add(std::uint32_t base, std::uint32_t size, Device* device);
  // A peripheral of the chip that has no model, for the message.
  void add_unmodelled(std::uint32_t base, std::uint32_t size, std::string name);

  std::uint32_t read(std::uint32_t address, std::uint32_t size);
  void write(std::uint32_t address, std::uint32_t value, std::uint32_t size);
  // Bytes moved by a PDC (peripheral DMA): SRAM and flash only. False if there is no memory.
  bool dma_read(std::uint32_t address, std::uint8_t& value) const;
  bool dma_write(std::uint32_t address, std::uint8_t value);
  void use_flash(std::uint32_t offset);

  Diagnostics& diagnostics() { return diagnostics_; }

  // The register at `address`, and which of its bits the outside can change.
  std::string name_of(std::uint32_t address) const;
  std::uint32_t outside_bits(std::uint32_t address) const;

  // Until end_rehearsal() no access reaches a peripheral: the first read gives `value`, writes are
  // lost.
  void rehearse(std::uint32_t value) { rehearsal_ = {true, false, value}; }
  void end_rehearsal() { rehearsal_ = {}; }

  WaitLoops waits;

 private:
  struct Rehearsal {
    bool on = false;
    bool has_read = false;
    std::uint32_t value = 0;
  };
  struct Unmodelled {
    std::uint32_t base;
    std::uint32_t size;
    std::string name;
  };

  // Peripherals below the system controller have 16 KiB each; in the system controller, the
  // smallest has 16 bytes.
  static constexpr std::uint32_t kPeripheralSize = 0x4000;
  static constexpr std::uint32_t kSystemGranule = 16;
  static constexpr std::uint32_t kPeripheralBase = 0x40000000;
  static constexpr std::uint32_t kSystemBase = 0x400E0000;
  static constexpr std::uint32_t kSystemEnd = 0x400E2000;

  Device* device_at(std::uint32_t address) const;
  std::uint8_t* memory_at(std::uint32_t address, std::uint32_t size, bool for_write);
  std::uint32_t read_peripheral(std::uint32_t address, std::uint32_t size);
  void write_peripheral(std::uint32_t address, std::uint32_t value, std::uint32_t size);
  // True when an unmodelled peripheral is there, after reporting it.
  bool report_unmodelled(std::uint32_t address, const char* verb);
  std::uint32_t read_device(std::uint32_t address, std::uint32_t size);
  [[noreturn]] void fail(std::uint32_t address, const char* verb);
  void check_private(std::uint32_t address, const char* verb);

  Memory& memory_;
  Diagnostics& diagnostics_;
  Cpu* cpu_ = nullptr;
  PrivateBus* private_bus_ = nullptr;
  FlashPort* flash_ = nullptr;
  std::array<Device*, (kSystemBase - kPeripheralBase) / kPeripheralSize> devices_{};
  std::array<Device*, (kSystemEnd - kSystemBase) / kSystemGranule> system_devices_{};
  std::vector<Unmodelled> unmodelled_;
  Rehearsal rehearsal_;
};

}  // namespace due_emulator
