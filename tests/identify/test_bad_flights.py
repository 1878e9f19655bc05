"""Flights from which nothing can be estimated give a one-line error: file, column, row, and what to do."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from heli_host.data.flight import REQUIRED_COLUMNS, Flight
from heli_host.data.log.table import write_csv

from tests.cli.terminal import Terminal, refusal

pytestmark = pytest.mark.medium

# Exit codes: the request is wrong, or the file is.
REQUEST_ERROR, FILE_ERROR = 2, 5
COUNT_RAD = 2 * np.pi / 4096
ROWS = 5000
STEP_S = 0.002


def flight() -> Flight:
    """Make ten seconds of sines on every axis, in whole encoder counts."""
    t_s = np.linspace(0.0, STEP_S * (ROWS - 1), ROWS)
    wave = np.sin(2 * np.pi * t_s / 3.0)
    volts = 1.7 + 0.2 * wave
    counts = np.round(np.outer((0.1, 0.2, 0.5), wave) / COUNT_RAD)
    elevation, pitch, travel = COUNT_RAD * counts.astype(np.float64)
    return Flight(t_s, volts, volts[::-1].copy(), elevation, pitch, travel)


Spoil = Callable[[Flight], Flight]


def with_cell(name: str, row: int, value: float) -> Spoil:
    """Replace a single value of the column `name`."""

    def spoil(made: Flight) -> Flight:
        column = getattr(made, name).copy()
        column[row] = value
        return replace(made, **{name: column})

    return spoil


def scaled(factor: float, *names: str) -> Spoil:
    """Multiply columns by a factor, as with another unit."""
    return lambda made: replace(made, **{name: factor * getattr(made, name) for name in names})


def without_rows(first: int, stop: int) -> Spoil:
    """Remove rows."""

    def spoil(made: Flight) -> Flight:
        keep = np.r_[0:first, stop:ROWS]
        return Flight(*(getattr(made, name)[keep] for name in REQUIRED_COLUMNS))

    return spoil


def with_smooth_pitch(made: Flight) -> Flight:
    """Replace pitch by 3 degrees at 2 Hz without encoder counts, in degrees, as some simulations log it."""
    return replace(made, pitch_rad=3.0 * np.sin(2 * np.pi * 2.0 * made.t_s))


def wrapped(made: Flight) -> Flight:
    """Let travel jump from +pi to -pi rad."""
    turned = 3.0 + made.travel_rad
    return replace(made, travel_rad=(turned + np.pi) % (2 * np.pi) - np.pi)


def with_uneven_clock(made: Flight) -> Flight:
    """Let the clock run fast and slow by turns."""
    clock_s = made.t_s + 0.1 * np.sin(2 * np.pi * made.t_s / 8.0)
    return replace(made, t_s=clock_s)


# By fault: how to spoil a flight, and exit code, column, row and words of the error.
SPOILED: dict[str, tuple[Spoil, int, str, str, str]] = {
    "no voltages": (
        scaled(0.0, "front_V"),
        REQUEST_ERROR,
        "front_V",
        "data row 1 to 5000",
        "log the voltages",
    ),
    "constant voltages": (
        lambda made: replace(made, front_V=np.full(ROWS, 1.7)),
        REQUEST_ERROR,
        "front_V",
        "data row 1 to 5000",
        "voltages that change",
    ),
    "duties": (scaled(0.1, "front_V", "back_V"), REQUEST_ERROR, "front_V", "data row 375", "is a duty cycle"),
    "a gap": (without_rows(1000, 1200), FILE_ERROR, "t_s", "line 1002", "jumps by"),
    "not a number": (with_cell("pitch_rad", 1233, np.nan), FILE_ERROR, "pitch_rad", "line 1235", "is nan"),
    "degrees": (
        scaled(180 / np.pi, "elevation_rad", "pitch_rad", "travel_rad"),
        FILE_ERROR,
        "elevation_rad",
        "line 343",
        "looks like degrees; multiply the angles by pi/180",
    ),
    "travel in degrees": (
        scaled(180 / np.pi, "travel_rad"),
        FILE_ERROR,
        "travel_rad",
        "line 3",
        "looks like degrees; multiply the angles by pi/180",
    ),
    "degrees without steps": (
        with_smooth_pitch,
        FILE_ERROR,
        "pitch_rad",
        "line ",
        "looks like degrees; multiply the angles by pi/180",
    ),
    "millivolts": (scaled(1000.0, "back_V"), FILE_ERROR, "back_V", "line 126", "millivolts"),
    "milliseconds": (scaled(1000.0, "t_s"), FILE_ERROR, "t_s", "line 3", "give t_s in seconds"),
    "an uneven clock": (with_uneven_clock, REQUEST_ERROR, "t_s", "data row", "resample"),
    "too few rows": (without_rows(5, ROWS), FILE_ERROR, "t_s", "5 rows", "record a flight of at least"),
    "too short": (without_rows(300, ROWS), REQUEST_ERROR, "t_s", "data row 1 to 300", "give a longer flight"),
    "never moving": (
        scaled(0.0, "elevation_rad", "pitch_rad", "travel_rad"),
        REQUEST_ERROR,
        "elevation_rad",
        "data row 1 to 5000",
        "never moves",
    ),
}


@pytest.mark.parametrize("fault", SPOILED)
def test_useless_flight_gives_a_one_line_error_and_no_files(
    terminal: Terminal, tmp_path: Path, fault: str
) -> None:
    spoil, code, column, row, words = SPOILED[fault]
    write_csv(spoil(flight()), tmp_path / "bad.csv")
    line = refusal(terminal("identify", "bad.csv", "--save-rig", "new.toml", "--json", "new.json"), code=code)
    assert "bad.csv" in line and column in line and row in line, line
    assert words in line, line
    assert not (tmp_path / "new.toml").exists() and not (tmp_path / "new.json").exists()


def test_a_wrapped_angle_is_named_on_a_rig_that_turns_freely(terminal: Terminal, tmp_path: Path) -> None:
    write_csv(wrapped(flight()), tmp_path / "bad.csv")
    line = refusal(terminal("identify", "bad.csv", "--rig", "quanser-course"), code=REQUEST_ERROR)
    assert "bad.csv: travel_rad jumps by 6.28 in data row 70; unwrap the angle" in line


def test_a_missing_column_is_named(terminal: Terminal, tmp_path: Path) -> None:
    write_csv(flight(), tmp_path / "bad.csv")
    text = (tmp_path / "bad.csv").read_text()
    (tmp_path / "bad.csv").write_text(text.replace("front_V", "front_duty", 1))
    line = refusal(terminal("identify", "bad.csv"), code=FILE_ERROR)
    assert "bad.csv: column front_V is missing" in line


def test_error_names_the_file_of_a_bad_validation_flight(terminal: Terminal, tmp_path: Path) -> None:
    write_csv(flight(), tmp_path / "good.csv")
    write_csv(scaled(0.0, "front_V")(flight()), tmp_path / "bad.csv")
    line = refusal(
        terminal("identify", "good.csv", "--validate", "bad.csv", "--skip-sign-check"), code=REQUEST_ERROR
    )
    assert "bad.csv: front_V is 0" in line


def test_a_gap_is_left_out_on_request(terminal: Terminal, tmp_path: Path) -> None:
    write_csv(without_rows(1000, 1200)(flight()), tmp_path / "gap.csv")
    result = terminal(
        "identify",
        "gap.csv",
        "--allow-gaps",
        "--free",
        "thrust_gain",
        "--json",
        "new.json",
        "--skip-sign-check",
    )
    assert result.code == 0, result
    assert (tmp_path / "new.json").exists()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("good.csv", "--rig", "nowhere"), "unknown rig 'nowhere'"),
        (("good.csv", "--model", "multibdy"), "did you mean multibody?"),
        (("good.csv", "--free", "thrust_gian"), "did you mean thrust_gain?"),
        (("good.csv", "--free", "supply"), "no parameter 'supply'"),
        (("good.csv", "--free", "reverse_thrust"), "give it a tolerance"),
        (("good.csv", "--free", "M_f", "--fix", "M_f"), "is in both --free and --fix"),
        (("good.csv", "--validate", "good.csv"), "both fitted and validated on"),
        (("good.csv", "good.csv"), "the same label"),
        (("good.csv", "--from", "9.5"), "no second of free flight"),
        (("missing.csv",), "cannot read missing.csv"),
    ],
)
def test_impossible_request_gives_a_one_line_error(
    terminal: Terminal, tmp_path: Path, arguments: tuple[str, ...], words: str
) -> None:
    write_csv(flight(), tmp_path / "good.csv")
    # The check of signs would refuse these artificial waves first.
    result = terminal("identify", *arguments, "--skip-sign-check")
    assert words in refusal(result, code=result.code)
    assert result.code in (REQUEST_ERROR, FILE_ERROR)
