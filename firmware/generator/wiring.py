"""The wiring: reads and checks pins.toml, and writes the header and the tables of pins."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from firmware.generator.declared import DeclarationError, read_toml

AXES = ("elevation", "pitch", "travel")
LINES = ("forward_pwm", "reverse_pwm", "forward_enable", "reverse_enable")
KEYS: Mapping[str, tuple[str, ...]] = {
    "encoders": ("TC0", "TC2", "interrupt"),
    "front": LINES,
    "back": LINES,
    "pwm": ("frequency_Hz", "inverted"),
    "enable": ("inverted",),
    "stop": ("stops_when",),
}

# From D0 on. Source: Arduino, variants/arduino_due_x/variant.cpp.
_CHIP_PINS = """
    PA8 PA9 PB25 PC28 PC26 PC25 PC24 PC23 PC22 PC21 PC29 PD7 PD8 PB27 PD4 PD5 PA13 PA12 PA11 PA10 PB12 PB13
    PB26 PA14 PA15 PD0 PD1 PD2 PD3 PD6 PD9 PA7 PD10 PC1 PC2 PC3 PC4 PC5 PC6 PC7 PC8 PC9 PA19 PA20 PC19 PC18
    PC17 PC16 PC15 PC14 PC13 PC12 PB21 PB14
"""
CHIP_PINS: Mapping[str, str] = {f"D{number}": pin for number, pin in enumerate(_CHIP_PINS.split())}
"""Pins of the chip by the names that are printed on the Due."""
ENCODER_PINS: Mapping[str, tuple[str, str]] = {
    "TC0": ("D2", "D13"),
    "TC2": ("D5", "D4"),
    "interrupt": ("D25", "D26"),
}
INDEX_PINS: Mapping[str, tuple[str, str]] = {"TC0": ("A6", "PA3"), "TC2": ("D10", "PC29")}
"""Pins that the chip connects with the index inputs of its two decoders: on the Due, and on the chip."""
PWM_CHANNELS: Mapping[str, int] = {"D9": 4, "D8": 5, "D7": 6, "D6": 7}
STOP_PIN = "D29"
SERIAL_PINS = ("D0", "D1")
PULLED_UP = ("D20", "D21")
"""The Due has resistors of 1.5 k from these two pins to 3.3 V, which are stronger than the pull-down of an enable
line: the bridge would be on during a reset of the chip."""
ENABLE_PINS = tuple(
    f"D{number}"
    for number in range(14, 54)
    if f"D{number}" not in (*PULLED_UP, *ENCODER_PINS["interrupt"], STOP_PIN)
)
PWM_RANGE_HZ = (2000, 25000)
"""Permitted switching frequencies. Below the range, the number of duty steps, 42 MHz / frequency, would not fit 16
bits with a margin. A BTS7960 cannot switch faster (datasheet, section 1)."""


@dataclass(frozen=True)
class Driver:
    """Lines of one motor's driver, as pins of the Due such as ``D9``."""

    forward_pwm: str  # RPWM and LPWM
    reverse_pwm: str  # RPWM and LPWM
    forward_enable: str  # R_EN and L_EN
    reverse_enable: str  # R_EN and L_EN


@dataclass(frozen=True)
class Wiring:
    """Connections of the pins, and the meaning of their levels."""

    encoders: Mapping[str, str]  # Axis by input: ``TC0``, ``TC2`` and ``interrupt``
    front: Driver  # Drivers of the two motors
    back: Driver  # Drivers of the two motors
    pwm_Hz: int  # Switching frequency
    pwm_inverted: bool  # Whether a low level means on
    enable_inverted: bool  # Whether a low level means on
    stop_is_high: bool  # Whether a high level stops

    def encoder_pins(self, axis: str) -> tuple[str, str]:
        """Return the pins of an axis: A and B."""
        return next(ENCODER_PINS[name] for name, counted in self.encoders.items() if counted == axis)


def read_pins(path: Path) -> Wiring:
    """Return the wiring in a file."""
    tables = read_toml(path)
    for problem in _wrong_keys(tables):
        raise DeclarationError(problem)
    wiring = Wiring(
        encoders=tables["encoders"],
        front=Driver(**tables["front"]),
        back=Driver(**tables["back"]),
        pwm_Hz=tables["pwm"]["frequency_Hz"],
        pwm_inverted=tables["pwm"]["inverted"],
        enable_inverted=tables["enable"]["inverted"],
        stop_is_high=tables["stop"]["stops_when"] == "high",
    )
    for problem in _impossible(wiring, tables["stop"]["stops_when"]):
        raise DeclarationError(problem)
    return wiring


def _wrong_keys(tables: Mapping[str, Any]) -> Iterator[str]:
    """Yield an error message for each missing, unknown or mistyped entry."""
    for name in tables:
        if name not in KEYS:
            yield f"unknown section [{name}]; choose from {', '.join(KEYS)}"
    for name, keys in KEYS.items():
        section = tables.get(name)
        if not isinstance(section, dict):
            yield f"the section [{name}] is missing; copy it from firmware/pins.toml"
            continue
        for key in section:
            if key not in keys:
                yield f"[{name}] has an unknown entry {key!r}; choose from {', '.join(keys)}"
        for key in keys:
            if key not in section:
                yield f"[{name}] lacks {key}; copy it from firmware/pins.toml"
    lines = [(name, key) for name in ("encoders", "front", "back") for key in KEYS[name]]
    for section, key, kind, example in (
        *((name, key, str, "a name in quotes") for name, key in (*lines, ("stop", "stops_when"))),
        ("pwm", "frequency_Hz", int, "a whole number"),
        ("pwm", "inverted", bool, "true or false"),
        ("enable", "inverted", bool, "true or false"),
    ):
        value = tables[section][key]
        if not isinstance(value, kind) or (kind is int and isinstance(value, bool)):
            yield f"{section}.{key} is {value!r}; write {example}"


def _impossible(wiring: Wiring, stops_when: str) -> Iterator[str]:
    """Yield an error message for each pin or value that the board cannot have."""
    if sorted(wiring.encoders.values()) != sorted(AXES):
        yield f"[encoders] counts {', '.join(wiring.encoders.values())}; name each of {', '.join(AXES)} once"
    used: dict[str, str] = {}
    for motor, driver in (("front", wiring.front), ("back", wiring.back)):
        for line in LINES:
            pin, name = getattr(driver, line), f"{motor}.{line}"
            if line.endswith("pwm") and pin not in PWM_CHANNELS:
                yield f"{name} is {pin!r}; only {', '.join(PWM_CHANNELS)} have a PWM output of the group"
            if line.endswith("enable") and pin not in ENABLE_PINS:
                yield f"{name} is {pin!r}; {_why_no_enable(pin)}"
            if pin in used:
                yield f"{name} and {used[pin]} are both {pin}; give each line a pin of its own"
            used[pin] = name
    low_Hz, high_Hz = PWM_RANGE_HZ
    if not low_Hz <= wiring.pwm_Hz <= high_Hz:
        yield f"pwm.frequency_Hz is {wiring.pwm_Hz}; choose {low_Hz} to {high_Hz}"
    if stops_when not in ("high", "low"):
        yield f"stop.stops_when is {stops_when!r}; choose high or low"


def _why_no_enable(pin: str) -> str:
    """Return why a pin cannot be an enable line, and what to choose instead."""
    if pin in PULLED_UP:
        return "the board pulls it up, so the bridge would be on during a reset; choose another of D14 to D53"
    if pin in (*ENCODER_PINS["interrupt"], STOP_PIN):
        return "an encoder or the stop needs it; choose another of D14 to D53"
    return "choose one of D14 to D53, without D20 and D21"


BEGIN = "<!-- Written by firmware/generate.py from firmware/pins.toml. -->"
END = "<!-- End of the written part. -->"
TERMINALS = {
    "forward_pwm": ("Forward", "RPWM"),
    "reverse_pwm": ("Reverse", "LPWM"),
    "forward_enable": ("ForwardEnable", "R_EN"),
    "reverse_enable": ("ReverseEnable", "L_EN"),
}
LED_PIN = "D13"


def generate_header(wiring: Wiring) -> str:
    """Return the text of firmware/due/wiring.hpp."""
    return "\n".join(
        [
            "// Written by firmware/generate.py from firmware/pins.toml. Do not edit.",
            "// What can be wired in more than one way; pins.hpp has what the chip fixes.",
            "#pragma once",
            "",
            "#include <cstddef>",
            "#include <cstdint>",
            "",
            '#include "board.hpp"',
            '#include "pins.hpp"',
            "",
            "namespace heli::due::wiring {",
            "",
            *(
                f"inline constexpr std::size_t {_input(name)}Axis = k{axis.title()};"
                for name, axis in wiring.encoders.items()
            ),
            *(
                line
                for name, driver in (("Front", wiring.front), ("Back", wiring.back))
                for line in _driver(name, driver)
            ),
            "",
            f"inline constexpr std::uint32_t kPwm_Hz = {wiring.pwm_Hz};",
            f"inline constexpr bool kPwmInverted = {_cpp(wiring.pwm_inverted)};",
            f"inline constexpr bool kEnableInverted = {_cpp(wiring.enable_inverted)};",
            f"inline constexpr bool kStopIsHigh = {_cpp(wiring.stop_is_high)};",
            "",
            "}  // namespace heli::due::wiring",
            "",
        ]
    )


def rows(wiring: Wiring) -> Iterator[tuple[str, str, str, str]]:
    """Yield each wire: signal, pin, what the wire connects to, and the resistor at the pin."""
    for axis in AXES:
        for line, pin in zip("AB", wiring.encoder_pins(axis), strict=True):
            connected_with = (
                "1 k to 3.3 V: the board's LED loads this pin" if pin == LED_PIN else "1-2.2 k to 3.3 V"
            )
            yield f"{axis.title()}{line}", pin, f"{axis} encoder, {line}", connected_with
    resistor = "4.7-10 k to 3.3 V" if wiring.enable_inverted else "4.7-10 k to ground"
    for motor, driver in (("front", wiring.front), ("back", wiring.back)):
        for line in (*LINES[2:], *LINES[:2]):
            name, terminal = TERMINALS[line]
            yield (
                f"{motor.title()}{name}",
                getattr(driver, line),
                f"{motor} driver, {terminal}",
                resistor if "enable" in line else "",
            )
    switch = "normally closed to ground" if wiring.stop_is_high else "normally open to ground"
    yield "HardwareStop", STOP_PIN, f"stop switch, {switch}", "4.7 k to 3.3 V"
    yield "Receive", SERIAL_PINS[0], "nothing: the USB bridge on the board drives it", ""
    yield "Transmit", SERIAL_PINS[1], "nothing: the USB bridge on the board listens to it", ""


def generate_table(wiring: Wiring) -> str:
    """Return the table of the wires in Markdown, with the marks before and after it."""
    lines = [BEGIN, "", "| signal | Due | chip | goes to | with |", "|---|---|---|---|---|"]
    for name, pin, goes_to, resistor in rows(wiring):
        resistor_cell = f" {resistor} " if resistor else " "
        lines.append(f"| `{name}` | {pin} | {CHIP_PINS[pin]} | {goes_to} |{resistor_cell}|")
    for decoder in ("TC2", "TC0"):
        axis = wiring.encoders[decoder]
        pin, chip_pin = INDEX_PINS[decoder]
        lines.append(
            f"| index of {axis} | {pin} | {chip_pin} | **nothing**: an edge there clears the {axis} count [D] | |"
        )
    return "\n".join([*lines, "", END])


def with_table(page: str, wiring: Wiring) -> str:
    """Return a page in which the table between the two marks is replaced by the present one."""
    before, has_begin, after_begin = page.partition(BEGIN)
    _, has_end, after = after_begin.partition(END)
    if not (has_begin and has_end):
        raise DeclarationError(
            f"docs/how-to/wiring.md lacks the marks {BEGIN!r} and {END!r}; put them back around its table"
        )
    return before + generate_table(wiring) + after


def _driver(name: str, driver: Driver) -> Iterator[str]:
    """Yield the pins and PWM channels of a motor's driver as C++ constants."""
    constants = {}
    for line in LINES:
        pin, (suffix, terminal) = getattr(driver, line), TERMINALS[line]
        chip = CHIP_PINS[pin]
        constants[f"inline constexpr Pin k{name}{suffix}{{PIO{chip[1]}, {chip[2:]}}};"] = (
            f"  // {pin}, {terminal}"
        )
    # As clang-format aligns comments.
    width = max(map(len, constants))
    yield ""
    yield from (f"{constant:{width}}{comment}" for constant, comment in constants.items())
    for line in LINES[:2]:
        channel = PWM_CHANNELS[getattr(driver, line)]
        yield f"inline constexpr unsigned k{name}{TERMINALS[line][0]}Channel = {channel};"


def _input(name: str) -> str:
    """Return the name of an encoder input in C++."""
    return "kInterrupt" if name == "interrupt" else f"k{name.title()}"


def _cpp(value: bool) -> str:
    """Return a truth value in C++."""
    return "true" if value else "false"
