// Levels of the pins from their drivers, and calls of their listeners; see pins.hpp.
#include "chip/pins.hpp"

#include <string>

namespace due_emulator {

namespace {

// "PA9"
std::string pin_name(int pin) {
  return std::string("P") + static_cast<char>('A' + pin / 32) + std::to_string(pin % 32);
}

}  // namespace

void Pins::connect_driver(int pin, bool peripheral_b, PinDriver* driver, int signal) {
  wires_[index(pin)].drivers[peripheral_b ? 1 : 0] = {driver, signal};
}

void Pins::connect_listener(int pin, PinListener* listener, int signal) {
  wires_[index(pin)].listeners.push_back({listener, signal});
}

void Pins::join(int first, int second) {
  wires_[index(first)].joined = second;
  wires_[index(second)].joined = first;
}

// See pins.hpp. A peripheral drives the pin if the PIO has given it the pin, otherwise the PIO's
// own output; an open-drain output only drives low.
bool Pins::driven(int pin, bool& level) const {
  const Wire& wire = wires_[index(pin)];
  if (wire.setting.given_to_peripheral) {
    const Driver& driver = wire.drivers[wire.setting.peripheral_b ? 1 : 0];
    if (driver.source == nullptr || !driver.source->drives(driver.signal)) return false;
    level = driver.source->level(driver.signal);
    return true;
  }
  if (!wire.setting.output || (wire.setting.open_drain && wire.setting.high)) return false;
  level = wire.setting.high;
  return true;
}

// Adds what pulls at one pin to the votes of its wire.
void Pins::vote(int pin, Votes& votes) const {
  const Wire& wire = wires_[index(pin)];
  bool high = false;
  if (driven(pin, high)) (high ? votes.strong_high : votes.strong_low) = true;
  switch (wire.external) {
    case External::kLow:
      votes.strong_low = true;
      break;
    case External::kHigh:
      votes.strong_high = true;
      break;
    case External::kPullDown:
      votes.weak_low = true;
      break;
    case External::kPullUp:
      votes.weak_high = true;
      break;
    case External::kOpen:
      break;
  }
  votes.pull_up = votes.pull_up || wire.setting.pull_up;
}

// The strongest driver decides, as pins.hpp says. Two strong ones that differ are reported.
bool Pins::level(int pin) const {
  Votes votes;
  vote(pin, votes);
  const int joined = wires_[index(pin)].joined;
  if (joined >= 0) vote(joined, votes);
  if (votes.strong_low && votes.strong_high) {
    diagnostics_.report(Trouble::kContention, static_cast<std::uint32_t>(pin),
                        "pin " + pin_name(pin) + " is driven high and low at once");
  }
  if (votes.strong_low) return false;
  if (votes.strong_high) return true;
  if (votes.weak_low) return false;
  return votes.weak_high || votes.pull_up;
}

// Notes the level at a pin and calls the listeners, if it has changed.
void Pins::tell(int pin, bool level, std::uint64_t now) {
  std::uint32_t& seen = seen_[index(pin) / 32];
  const std::uint32_t mask = 1U << (pin % 32);
  if (((seen & mask) != 0) == level) return;
  seen ^= mask;
  PinListener* port = ports_[index(pin) / 32];
  if (port != nullptr) port->pin_changed(pin % 32, level, now);
  for (const Listener& listener : wires_[index(pin)].listeners)
    listener.sink->pin_changed(listener.signal, level, now);
}

// Finds the level of a pin's wire and tells it to this pin and to the one that is joined with it.
void Pins::refresh(int pin, std::uint64_t now) {
  const bool value = level(pin);
  tell(pin, value, now);
  const int joined = wires_[index(pin)].joined;
  if (joined >= 0) tell(joined, value, now);
}

void Pins::set_external(int pin, External state, std::uint64_t now) {
  if (wires_[index(pin)].external == state) return;
  wires_[index(pin)].external = state;
  refresh(pin, now);
}

void Pins::set_setting(int pin, const PinSetting& setting, std::uint64_t now) {
  wires_[index(pin)].setting = setting;
  refresh(pin, now);
}

}  // namespace due_emulator
