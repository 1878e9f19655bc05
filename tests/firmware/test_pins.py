"""A board that is wired in another way flies with firmware built from its own pins.toml."""

from __future__ import annotations

import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from firmware.generator.declared import DeclarationError
from firmware.generator.wiring import CHIP_PINS, generate_header, read_pins, rows
from tests.firmware.built import BUILD, ROOT, built_elf

PINS = ROOT / "firmware" / "pins.toml"
FIGURE = ROOT / "docs" / "figures" / "wiring.py"
# Every entry differs from the paper's wiring; the enables are on ports A to D.
OTHER = """
[encoders]
TC0 = "travel"
TC2 = "elevation"
interrupt = "pitch"
[front]
forward_pwm = "D6"
reverse_pwm = "D7"
forward_enable = "D33"
reverse_enable = "D52"
[back]
forward_pwm = "D8"
reverse_pwm = "D9"
forward_enable = "D42"
reverse_enable = "D27"
[pwm]
frequency_Hz = 10000
inverted = true
[enable]
inverted = true
[stop]
stops_when = "low"
"""


def edited(old: str, new: str) -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        text = PINS.read_text()
        assert old in text
        path = folder / "my.toml"
        path.write_text(text.replace(old, new, 1))
        return path

    return write


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('"D9" ', '"D3" ', "front.forward_pwm is 'D3'; only D9, D8, D7, D6 have a PWM output"),
        ('"D22"', '"D20"', "front.forward_enable is 'D20'; the board pulls it up"),
        ('"D22"', '"D26"', "an encoder or the stop needs it"),
        ('"D22"', '"A0"', "choose one of D14 to D53"),
        ('"D24"', '"D22"', "back.forward_enable and front.forward_enable are both D22"),
        ('"D7"', '"D9"', "back.forward_pwm and front.forward_pwm are both D9"),
        ('TC2 = "pitch"', 'TC2 = "travel"', "name each of elevation, pitch, travel once"),
        ("frequency_Hz = 20000", "frequency_Hz = 30000", "choose 2000 to 25000"),
        ("frequency_Hz = 20000", "frequency_Hz = true", "pwm.frequency_Hz is True; write a whole number"),
        ("inverted = false", "inverted = 0", "pwm.inverted is 0; write true or false"),
        ('stops_when = "high"', 'stops_when = "open"', "choose high or low"),
        ("[enable]", "[enables]", "unknown section [enables]"),
        ("[stop]\n", "[stop]\npin = 3\n", "[stop] has an unknown entry 'pin'"),
        ('interrupt = "travel"', "", "[encoders] lacks interrupt"),
        ("[encoders]", "[encoders", "cannot be read"),
    ],
)
def test_a_wiring_that_the_board_cannot_have_is_refused(
    old: str, new: str, message: str, tmp_path: Path
) -> None:
    with pytest.raises(DeclarationError) as caught:
        read_pins(edited(old, new)(tmp_path))
    assert message in str(caught.value)


def test_a_missing_file_is_one_line(tmp_path: Path) -> None:
    process = subprocess.run(
        [sys.executable, ROOT / "firmware/pio/build.py", "--pins", tmp_path / "none.toml"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert process.returncode == 2
    assert process.stderr.startswith(f"error: {tmp_path / 'none.toml'}: cannot be read")
    assert process.stderr.count("\n") == 1


@pytest.mark.medium
def test_the_figure_of_another_wiring_has_its_pins(tmp_path: Path) -> None:
    (tmp_path / "my.toml").write_text(OTHER)
    drawn = tmp_path / "wiring.svg"
    subprocess.run([sys.executable, FIGURE, drawn, tmp_path / "my.toml"], check=True, capture_output=True)
    text = drawn.read_text()
    assert all(pin in text for pin in ("D33", "PC1", "D52", "PB21", "stop: normally open"))
    assert "D22" not in text


def test_every_pin_of_the_due_has_its_own_pin_of_the_chip() -> None:
    assert len(CHIP_PINS) == len(set(CHIP_PINS.values())) == 54
    # The emulated board's own table is the witness: sim/due_board/wiring.cpp.
    wires = (ROOT / "sim" / "due_board" / "wiring.cpp").read_text()
    for _, pin, _, _ in rows(read_pins(PINS)):
        port, number = CHIP_PINS[pin][1], CHIP_PINS[pin][2:]
        assert pin in ("D0", "D1") or f"pin_of('{port}', {number})" in wires


def build(pins: Path, folder: Path) -> Path:
    """Firmware for another wiring; objects that do not depend on it are those of the tests' firmware."""
    built_elf()
    wiring = read_pins(pins)
    (folder / "include").mkdir()
    (folder / "include" / "wiring.hpp").write_text(generate_header(wiring))
    shutil.copytree(BUILD, folder / "build", ignore=shutil.ignore_patterns("lock", "heli.*"))
    for depends in (folder / "build").rglob("*.d"):
        if "wiring.hpp" in depends.read_text():
            depends.with_suffix(".o").unlink()
        depends.unlink()
    subprocess.run(
        ["make", "-s", "-C", ROOT / "firmware" / "due", f"BUILD={folder / 'build'}",
         f"WIRING={folder / 'include'}", folder / "build" / "heli.elf"],
        check=True, capture_output=True, text=True,
    )  # fmt: skip
    return folder / "build" / "heli.elf"


@pytest.mark.emulated
def test_another_wiring_flies_and_stops(tmp_path: Path) -> None:
    pytest.importorskip("due_emulator._due", reason="the emulated Due is not built: make setup")
    pytest.importorskip("elftools", reason="pyelftools is missing: make setup")
    from firmware.due.report import read_image
    from tests.firmware.desk import RewiredBoard

    (tmp_path / "my.toml").write_text(OTHER)
    elf = build(tmp_path / "my.toml", tmp_path)
    board = RewiredBoard(elf, read_image(elf))
    for _ in range(1000):
        assert board.off()
        assert board.pwm_high()
        board.due.run_us(20.0)
    heli = board.connect()
    assert board.off() and board.bridges_idle()
    heli.take_off(0.0)
    heli.setpoint(elevation_deg=5.0, travel_deg=20.0)
    heli.wait(12.0)
    assert board.on()
    assert board.due.pwm_period_cycles(4) == 84_000_000 // 10_000
    elevation_deg, pitch_deg, travel_deg = board.angles_deg()
    assert abs(elevation_deg - 5.0) < 3.0
    assert abs(travel_deg - 20.0) < 6.0
    assert abs(pitch_deg) < 10.0
    board.press_stop()
    # In hardware, before the program knows: within one PWM period.
    board.due.run_us(250.0)
    assert board.bridges_idle()
    board.advance(3)
    assert board.off()
