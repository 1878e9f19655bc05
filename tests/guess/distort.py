"""Flights written as other people write them, from a seed, and whether a guess of them is silently wrong."""

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np
from heli_host.data.arrays import Floats
from heli_host.data.flight import Flight
from heli_host.data.tables import flights_of, read_table
from heli_host.errors import HeliError
from heli_lab.setup.guess import Guess, guess
from heli_sim.rig import Rig

NAMES: Final = {
    "own": ("t_s", "front", "back", "elevation", "pitch", "travel", "sum", "difference"),
    "short": ("t", "V_f", "V_b", "e", "p", "lambda", "V_s", "V_d"),
    "long": (
        "Time",
        "Front motor",
        "Rear motor",
        "Elevation angle",
        "Pitch angle",
        "Travel angle",
        "Vsum",
        "Vdiff",
    ),
    "greek": ("time", "uf", "ub", "theta", "phi", "psi", "us", "ud"),
    "letters": ("c0", "c1", "c2", "c3", "c4", "c5", "c1", "c2"),
    "none": ("", "", "", "", "", "", "", ""),
}
"""Time, front, back, elevation, pitch, travel, sum, difference."""
RATES_Hz: Final = (50.0, 100.0, 125.0, 200.0, 250.0, 500.0, 1000.0)


@dataclass(frozen=True)
class Distortion:
    """What is done to a flight."""

    # `names`: Key of `NAMES`.
    # `angle`, `voltage`, `time`: Units.
    # `stated`: Whether names say the unit.
    # `signs`: Signs of elevation, pitch and travel.
    # `swapped`: Motors exchanged under the same names.
    # `summed`: Sum and difference in place of the motors.
    # `rate_Hz`: Rows a second.
    # `late`: Which column is late, and by how much, s; empty and 0 where none is.
    # `at_rest`: Elevation is 0 where the flight begins, not at level.
    # `comma`: Decimal commas.
    # `others`: Columns that are something else.

    names: str
    angle: str
    voltage: str
    time: str
    stated: bool
    signs: tuple[float, float, float]
    swapped: bool
    summed: bool
    rate_Hz: float
    late: tuple[str, float]
    at_rest: bool
    comma: bool
    others: int

    def text(self) -> str:
        """What is done, in a line."""
        turned = [a for a, s in zip(("elevation", "pitch", "travel"), self.signs, strict=True) if s < 0]
        parts = [
            f"names {self.names}",
            f"{self.angle}/{self.voltage}/{self.time}{' stated' if self.stated else ''}",
            f"{self.rate_Hz:g} Hz",
            f"turned {'+'.join(turned)}" if turned else "",
            "swapped" if self.swapped else "",
            "summed" if self.summed else "",
            f"{self.late[0]} {self.late[1]:.2f} s late" if self.late[1] else "",
            "0 at rest" if self.at_rest else "",
            "commas" if self.comma else "",
            f"{self.others} others" if self.others else "",
        ]
        return ", ".join(part for part in parts if part)


def draw_distortion(seed: int) -> Distortion:
    """Draw a distortion."""
    random = np.random.default_rng(seed)

    def draw(choices: tuple[str, ...], shares: tuple[float, ...] | None = None) -> str:
        return str(random.choice(choices, p=shares))

    late = ("", 0.0)
    if random.random() < 0.3:
        late = (draw(("voltages", "elevation", "travel")), float(random.uniform(0.02, 0.25)))
    return Distortion(
        draw(tuple(NAMES)),
        draw(("rad", "deg", "count")),
        draw(("V", "mV", "duty", "percent", "pwm"), (0.5, 0.1, 0.15, 0.1, 0.15)),
        draw(("s", "ms", "us")),
        bool(random.random() < 0.5),
        tuple(float(random.choice((1.0, -1.0), p=(0.7, 0.3))) for _ in range(3)),  # type: ignore[arg-type]
        bool(random.random() < 0.2),
        bool(random.random() < 0.3),
        float(random.choice(RATES_Hz)),
        late,
        bool(random.random() < 0.3),
        bool(random.random() < 0.3),
        int(random.choice((0, 0, 2, 5))),
    )


def write(flight: Flight, rig: Rig, how: Distortion, path: Path, seed: int = 0) -> Flight:
    """Write a flight, distorted."""
    # Returns: The truth at the rate written: what a right profile makes of the file, delays and all.
    step_s = 1.0 / how.rate_Hz
    t_s = np.arange(flight.t_s[0], flight.t_s[-1], step_s)
    place = np.clip(np.searchsorted(flight.t_s, t_s + 1e-9, side="right") - 1, 0, None)
    angles = {axis: getattr(flight, f"{axis}_rad")[place].copy() for axis in ("elevation", "pitch", "travel")}
    front, back = flight.front_V[place].copy(), flight.back_V[place].copy()
    rows = round(how.late[1] / step_s)
    if rows:
        if how.late[0] == "voltages":
            front, back = _late(front, rows), _late(back, rows)
        else:
            angles[how.late[0]] = _late(angles[how.late[0]], rows)
    truth = Flight(t_s - t_s[0], front, back, angles["elevation"], angles["pitch"], angles["travel"])
    named = NAMES[how.names]
    columns: list[tuple[str, str, Floats]] = []
    unit_s = {"s": 1.0, "ms": 1e3, "us": 1e6}[how.time]
    columns.append((named[0], how.time, (t_s - t_s[0]) * unit_s))
    first, second = (back, front) if how.swapped else (front, back)
    pair = (first + second, first - second) if how.summed else (first, second)
    supply = rig["supply"].value
    per_V = {"V": 1.0, "mV": 1e3, "duty": 1 / supply, "percent": 100 / supply, "pwm": 255 / supply}
    for name, volts in zip(named[6:] if how.summed else named[1:3], pair, strict=True):
        scaled = volts * per_V[how.voltage]
        columns.append((name, how.voltage, np.round(scaled) if how.voltage == "pwm" else scaled))
    for name, axis, sign in zip(named[3:6], angles, how.signs, strict=True):
        angle = angles[axis] - (angles[axis][0] if how.at_rest and axis == "elevation" else 0.0)
        counts = rig[f"encoder_counts_{axis}"].value
        per_rad = {"rad": 1.0, "deg": 180.0 / math.pi, "count": counts / (2.0 * math.pi)}[how.angle]
        scaled = sign * angle * per_rad
        columns.append((name, how.angle, np.round(scaled) if how.angle == "count" else scaled))
    columns += _others(angles, how, np.random.default_rng(seed))
    order = [0, *(1 + np.random.default_rng(seed).permutation(len(columns) - 1))]
    _write([columns[i] for i in order], how, path)
    return truth


def _others(
    angles: dict[str, Floats], how: Distortion, random: np.random.Generator
) -> list[tuple[str, str, Floats]]:
    rate = np.gradient(angles["pitch"], 1.0 / how.rate_Hz)
    slow = np.convolve(angles["pitch"], np.ones(25) / 25.0, mode="same")
    count = angles["pitch"].size
    made: list[tuple[str, str, Floats]] = [
        ("pitch_ref", "", np.sign(slow) * 0.1),
        ("pitch rate", "", rate),
        ("temp", "", 20.0 + 0.01 * random.standard_normal(count).cumsum()),
        ("noise", "", random.standard_normal(count)),
        ("state", "", np.full(count, 3.0)),
    ]
    return made[: how.others]


def _late(values: Floats, rows: int) -> Floats:
    return np.concatenate((np.full(rows, values[0]), values[:-rows]))


def _write(columns: list[tuple[str, str, Floats]], how: Distortion, path: Path) -> None:
    separator = ";" if how.comma else ","
    lines = []
    if how.names != "none":
        shown = [f"{name} [{unit}]" if how.stated and unit else name for name, unit, _ in columns]
        lines.append(separator.join(shown))
    table = np.column_stack([values for _, _, values in columns])
    for row in table:
        text = separator.join(f"{value:.7g}" if abs(value) < 1e5 else f"{value:.0f}" for value in row)
        lines.append(text.replace(".", ",") if how.comma else text)
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


_MAX_RAD = 0.005
_MAX_ZERO_RAD = np.radians(6.5)
"""A table is where the rig file says, within its tolerance and what the guess accepts."""
_MAX_V_SHARE = 0.01
_MAX_LATE_s = {"travel": 0.14, "elevation": 0.22, "voltages": 0.25}
"""A delay longer than this may not pass unsaid: lags as a flight shows them scatter by 0.06 s and more."""


@dataclass(frozen=True)
class FileVerdict:
    """Result of a file."""

    # `verdict`: `right`, `unsure` (right all the same), `unsure, wrong`, `refused`, or `SILENTLY WRONG`.
    # `reason`: What is wrong, or open.

    verdict: str
    reason: str


def judge_file(path: Path, truth: Flight, how: Distortion, rig: Rig) -> FileVerdict:
    """Guess a file and compare with its truth."""
    try:
        table = read_table(path)
        guess_result = guess(table, rig)
    except HeliError as error:
        return FileVerdict("refused", str(error))
    imported = flights_of(table, guess_result.profile)[0]
    wrong = _wrong(imported, truth, how, guess_result)
    if wrong and guess_result.sure and not _wrong(_mirrored(imported), truth, how, guess_result):
        return FileVerdict("right", "in a mirror")
    open_ = "; ".join(ambiguity.subject for ambiguity in guess_result.ambiguities)
    if not wrong:
        return FileVerdict("right" if guess_result.sure else "unsure", open_)
    return FileVerdict("SILENTLY WRONG" if guess_result.sure else "unsure, wrong", f"{wrong} [{open_}]")


def _mirrored(flight: Flight) -> Flight:
    """The same flight with the other rotor called the front one."""
    # Where names and physics agree, nothing in a file distinguishes it from the flight itself, and no
    # equation depends on it.
    return replace(
        flight,
        front_V=flight.back_V,
        back_V=flight.front_V,
        pitch_rad=-flight.pitch_rad,
        travel_rad=-flight.travel_rad,
    )


def _wrong(made: Flight, truth: Flight, how: Distortion, guess_result: Guess) -> str:
    mistakes = []
    rows = min(len(made), len(truth))
    late_s = {axis: item.delay_s for axis, item in guess_result.profile.angles.items()}
    for name in ("elevation", "pitch", "travel"):
        shift = round(late_s[name] * how.rate_Hz)
        mine = getattr(made, f"{name}_rad")[: rows - abs(shift)]
        true = getattr(truth, f"{name}_rad")[max(shift, 0) :][: len(mine)]
        if len(true) < 10:
            return "nothing left"
        off = mine[: len(true)] - true
        if np.std(off) > _MAX_RAD or (name == "elevation" and abs(np.mean(off)) > _MAX_ZERO_RAD):
            mistakes.append(name)
        if name == "pitch" and abs(np.mean(off)) > _MAX_RAD:
            mistakes.append("pitch zero")
    for name in ("front_V", "back_V"):
        # Rows are lost at the beginning or the end where a delay was taken out.
        shift = max(0, round(-min(late_s.values()) * how.rate_Hz))
        mine, true = getattr(made, name)[: rows - shift], getattr(truth, name)[shift:rows]
        span = max(float(np.ptp(truth.voltages_V)), 1e-9)
        if float(np.abs(mine[: len(true)] - true[: len(mine)]).mean()) > _MAX_V_SHARE * span:
            mistakes.append(name)
    which, seconds = how.late
    if which and seconds > _MAX_LATE_s[which] and guess_result.sure:
        mistakes.append(f"{which} {seconds:.2f} s late")
    return ", ".join(mistakes)
