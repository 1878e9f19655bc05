"""The wiring as a C++ header, and as the table of docs/how-to/wiring.md."""

from __future__ import annotations

from collections.abc import Iterator

from firmware.generator.declared import DeclarationError
from firmware.generator.pins import (
    AXES,
    CHIP_PINS,
    LINES,
    PWM_CHANNELS,
    SERIAL_PINS,
    STOP_PIN,
    Driver,
    Wiring,
)

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
            '#include "pin.hpp"',
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
    for name, pin, goes_to, connected_with in rows(wiring):
        lines.append(
            f"| `{name}` | {pin} | {CHIP_PINS[pin]} | {goes_to} |{f' {connected_with} ' if connected_with else ' '}|"
        )
    for name, index, chip in (("TC2", "D10", "PC29"), ("TC0", "A6", "PA3")):
        axis = wiring.encoders[name]
        lines.append(
            f"| index of {axis} | {index} | {chip} | **nothing**: an edge there clears the {axis} count [D] | |"
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
