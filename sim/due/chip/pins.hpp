// The wires at the chip's pins: who drives them, and who listens.
//
// A level follows from all drivers: strong ones first (the chip's own output stages, external
// sources), then external resistors (a few kilohms), then the chip's pull-up (100 k).
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "bus/diagnostics.hpp"

namespace due_emulator {

inline constexpr int kPorts = 4;
inline constexpr int kPins = kPorts * 32;

// Pin number as port * 32 + bit.
constexpr int pin_of(char port, int bit) { return (port - 'A') * 32 + bit; }

// What is connected to a pin outside of the chip: nothing, a resistor, or a source.
enum class External : std::uint8_t { kOpen, kPullDown, kPullUp, kLow, kHigh };

// A peripheral that can put a signal on a pin. `signal` is its own number for the signal, given at
// connect_driver().
class PinDriver {
 public:
  virtual ~PinDriver() = default;
  // False: the peripheral leaves the pin alone, as an input function does.
  virtual bool drives(int signal) const = 0;
  virtual bool level(int signal) const = 0;
};

// A part of the chip that follows the level at a pin. `signal` is from connect_listener().
class PinListener {
 public:
  virtual ~PinListener() = default;
  virtual void pin_changed(int signal, bool level, std::uint64_t now) = 0;
};

// How the PIO controller has set one pin.
struct PinSetting {
  bool given_to_peripheral = false;
  bool peripheral_b = false;
  bool output = false;
  bool open_drain = false;
  bool high = false;
  bool pull_up = true;
};

class Pins {
 public:
  explicit Pins(Diagnostics& diagnostics) : diagnostics_(diagnostics) {}

  void connect_driver(int pin, bool peripheral_b, PinDriver* driver, int signal);
  void connect_listener(int pin, PinListener* listener, int signal);
  // Two pins that the board joins.
  void join(int first, int second);

  void set_external(int pin, External state, std::uint64_t now);
  External external(int pin) const { return wires_[index(pin)].external; }
  void set_setting(int pin, const PinSetting& setting, std::uint64_t now);
  const PinSetting& setting(int pin) const { return wires_[index(pin)].setting; }
  // A driver's signal has changed: finds the level again and calls the listeners.
  void refresh(int pin, std::uint64_t now);

  // Level on the wire now.
  bool level(int pin) const;
  // The levels of a port's pins that listeners know.
  std::uint32_t seen(int port) const { return seen_[index(port)]; }
  void set_port_listener(int port, PinListener* listener) {
    ports_[static_cast<std::size_t>(port)] = listener;
  }

  // Whether the chip itself drives this pin; if so, `level` is the level.
  bool driven(int pin, bool& level) const;

 private:
  struct Driver {
    PinDriver* source = nullptr;
    int signal = 0;
  };
  struct Listener {
    PinListener* sink;
    int signal;
  };
  struct Wire {
    PinSetting setting;
    External external = External::kOpen;
    Driver drivers[2];
    std::vector<Listener> listeners;
    int joined = -1;  // the pin that the board joins with this one
  };

  static std::size_t index(int pin) { return static_cast<std::size_t>(pin); }
  // What pulls at a wire, by strength.
  struct Votes {
    bool strong_low = false;
    bool strong_high = false;
    bool weak_low = false;
    bool weak_high = false;
    bool pull_up = false;
  };
  void vote(int pin, Votes& votes) const;
  void tell(int pin, bool level, std::uint64_t now);

  Diagnostics& diagnostics_;
  std::array<Wire, kPins> wires_;
  std::array<PinListener*, kPorts> ports_{};
  std::array<std::uint32_t, kPorts> seen_{};
};

}  // namespace due_emulator
