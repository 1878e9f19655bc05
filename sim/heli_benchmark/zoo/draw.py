"""Draw a case: the logger, the table that it records of a flight, and the truth."""

from __future__ import annotations

import datetime
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np
from heli_host.data.arrays import Floats
from heli_host.data.flight import Flight
from heli_host.declaration import AXES
from heli_sim.rig import Rig, load_rig

from heli_benchmark.zoo.case import ImportTruth, LogCase, LoggedColumn, Recording, Samples
from heli_benchmark.zoo.flights import FlightRecipe
from heli_benchmark.zoo.words import MOTORS, SUMS, UNIT_WORDS, VOCABULARIES, with_unit

_RATES_Hz: Final = (20.0, 25.0, 33.333333, 50.0, 60.0, 100.0, 125.0, 200.0, 250.0, 500.0, 1000.0)
_MAX_ROWS: Final = 12_000
_TEXT_KINDS: Final = ("csv", "txt")
_BAGS: Final = ("mcap", "ros2")
_CONTAINERS: Final = {
    "csv": 0.46,
    "txt": 0.1,
    "mat": 0.12,
    "xlsx": 0.07,
    "parquet": 0.09,
    "mcap": 0.08,
    "ros2": 0.08,
}
_NUMERIC_CLOCKS: Final = {
    "s": 0.24,
    "ms": 0.16,
    "us": 0.1,
    "ns": 0.02,
    "min": 0.01,
    "epoch s": 0.08,
    "epoch ms": 0.04,
    "five digits": 0.05,
    "tenths": 0.05,
    "whole seconds": 0.05,
    "overflow 16 ms": 0.04,
    "overflow 32 us": 0.04,
    "restart": 0.04,
    "rows": 0.04,
    "none": 0.04,
}
_TEXT_CLOCKS: Final = {
    "iso date": 0.3,
    "clock": 0.25,
    "local date": 0.15,
    "prefix": 0.1,
    "thousands": 0.1,
    "german date": 0.1,
}
_FINE_CLOCKS: Final = ("s", "ms", "us", "ns", "epoch s", "epoch ms", "iso date", "clock", "datetime", "min")
"""Clocks that are fine enough to show that rows are lost or in another order."""
_LINE_FAULTS: Final = ("truncated lines", "merged lines", "garbage", "repeated header", "error cells")
_ROW_FAULTS: Final = (
    *_LINE_FAULTS,
    "duplicated rows",
    "swapped rows",
    "lost rows",
    "long gap",
    "stalled values",
    "reversed",
)
_FAULTS_OF_THE_FILE: Final = (*_LINE_FAULTS, "duplicated rows", "swapped rows", "reversed")
"""Faults that are applied when the table is written; all others are in its numbers already."""
_DROPPED: Final = (
    r"damag|merged|incomplete|unreadable|broken"
    r"|(row|line|cell)s?\b[^.;\n]*\b(dropped|skipped|left out|ignored|omitted|not numbers)"
    r"|\b(dropped|skipped|left out|ignored|omitted)\b[^.;\n]*\b(row|line|cell)"
)
_REPORTS: Final = {
    "truncated lines": _DROPPED,
    "merged lines": _DROPPED,
    "garbage": _DROPPED,
    "repeated header": rf"header|{_DROPPED}",
    "error cells": rf"{_DROPPED}|empty|missing",
    "duplicated rows": r"duplicat|repeat|twice|same time",
    "swapped rows": r"out of order|sorted|order of",
    "reversed": r"out of order|sorted|order of|reversed|backwards|newest",
    "lost rows": r"fill|missing|\bgap|lost",
    "long gap": r"\bgap|divid|pause|interrupt|missing",
    "stalled values": r"still|frozen|stuck|stall|not change|same values",
    "overflow": r"overflow|wrapped|starts again",
    "restart": r"restart|starts? (again|anew|over)|begins? (again|anew)|falls|set back|jumps back",
    "coarse": r"coarse|resol|repeat|share their|whole|rounded|digits|evenly|even times|same time",
    "two rates": r"blank|empty|held|hold|slower|two rates|last value|fill",
}
"""Pattern of the words with which an import must report each repair. They are wide: any word will do."""


_REFUSALS: Final = {"voltages": r"volt|motor", "two angles": r"travel|pitch|elevation|two angles|angle"}
"""Pattern of the reason for which an import must refuse a file without voltages, or with two angles only."""


_FIRST_COUNT: Final = 500.0
"""Count at which a 16-bit counter of the travel starts [counts]."""


class _Random:
    """Draws of one case, by names."""

    def __init__(self, seed: int, number: int) -> None:
        self.rng = np.random.default_rng([seed, number])

    def chance(self, share: float) -> bool:
        return bool(self.rng.random() < share)

    def choice(self, items: Sequence[str]) -> str:
        return items[int(self.rng.integers(len(items)))]

    def weighted(self, weights: Mapping[str, float]) -> str:
        shares = np.array(list(weights.values()))
        return list(weights)[int(self.rng.choice(len(shares), p=shares / shares.sum()))]

    def between(self, low: float, high: float) -> float:
        return float(self.rng.uniform(low, high))


@dataclass(frozen=True)
class _Measured:
    """What the logger has sampled, in rad and V, before units and names."""

    true_s: Floats  # (n,): True times of the rows
    angles_rad: Mapping[str, Floats]
    volts_V: Mapping[str, Floats]


def draw_case(seed: int, number: int, recipes: Sequence[FlightRecipe], flights: Sequence[Flight]) -> LogCase:
    """Draw the case of a seed and a number; it records one of the `flights`, which `recipes` describe."""
    random = _Random(seed, number)
    index = int(random.rng.integers(len(flights)))
    recipe, flight = recipes[index], flights[index]
    return _Drawing(random, recipe, flight, load_rig(recipe.rig_name)).case(seed, number)


class _Clock(NamedTuple):
    """The time of each row, as a logger writes it."""

    values: Floats  # In the unit
    unit: str = "s"
    decimals: int = 6
    texts: tuple[str, ...] = ()  # Times as texts, if the logger writes texts


class _Drawing:
    """The draws of one case, one after the other."""

    def __init__(self, random: _Random, recipe: FlightRecipe, flight: Flight, rig: Rig) -> None:
        self.random, self.recipe, self.flight, self.rig = random, recipe, flight, rig
        self.traits: list[str] = []
        self.reports: dict[str, str] = {}
        self.unknown: list[str] = []
        self.value_step: dict[str, float] = {}
        self.columns: list[LoggedColumn] = []
        self.turned: list[str] = []  # Axes that the logger counts in the opposite direction
        self.battery_V: Floats | None = None  # Measured supply; None if the file has no such column
        self.lost_s = 0.0
        self.time_tolerance_s = 0.0

    def case(self, seed: int, number: int) -> LogCase:
        random = self.random
        # Each draw takes the next random numbers, so another order would change all cases of a seed.
        container = random.weighted(_CONTAINERS)
        self.style = self._style(container)
        self.words = VOCABULARIES[self.style]
        self.unit_style = self._unit_style(container)
        clock_kind = self._clock_kind(container)
        faults = self._row_faults(container, clock_kind)
        measured = self._sampled(clock_kind, container, faults)
        refusal = self._refusal()
        truth_samples = {
            **{axis: Samples(measured.true_s, measured.angles_rad[axis]) for axis in AXES},
            **{motor: Samples(measured.true_s, measured.volts_V[motor]) for motor in MOTORS},
        }
        self._angle_columns(measured, refusal)
        voltage_roles = self._voltage_columns(measured, refusal)
        self._extra_columns(measured, refusal, voltage_roles)
        if "stalled values" in faults:
            self._stall(measured)
        blank_rows = self._two_rates(container, measured, refusal, truth_samples)
        order = random.rng.permutation(len(self.columns))
        columns = tuple(self.columns[i] for i in order)
        recording, rate_Hz = self._clocked(clock_kind, container, measured, columns)
        known = self._known_columns(columns, refusal)
        for fault in faults:
            self.reports[fault] = _REPORTS[fault]
        if blank_rows:
            self.reports["two rates"] = _REPORTS["two rates"]
        # Neither the file nor the user states the time.
        without_time = clock_kind == "none" and not rate_Hz
        truth = ImportTruth(
            truth_samples,
            row_count=measured.true_s.size,
            time_tolerance_s=self.time_tolerance_s,
            value_step=self.value_step,
            lost_s=self.lost_s,
            refusal=r"time|rate|clock" if without_time else _REFUSALS.get(refusal, ""),
            reports=self.reports,
            unknown=tuple(self.unknown),
        )
        self.traits += [container, f"clock {clock_kind}", f"names {self.style}/{self.unit_style}", *faults]
        gives_rig = random.chance(0.7)
        self.traits.append(f"rig {self.recipe.rig_name}{'' if gives_rig else ' (not given)'}")
        return LogCase(
            seed,
            number,
            tuple(self.traits),
            container,
            recording,
            truth,
            rig_name=self.recipe.rig_name,
            gives_rig=gives_rig,
            rate_Hz=rate_Hz,
            known_columns=known,
            row_faults=tuple(fault for fault in faults if fault in _FAULTS_OF_THE_FILE),
            dialect=self._dialect(clock_kind),
        )

    def _unit_style(self, container: str) -> str:
        """Draw how names state their units; without names, and in messages, they do not."""
        style = self.random.choice(("none", "none", "brackets", "parentheses", "tail", "row", "slash"))
        if self.style == "none" or container in _BAGS:
            return "none"
        if style == "row" and container not in (*_TEXT_KINDS, "xlsx"):
            return "brackets"
        return style

    def _dialect(self, clock_kind: str) -> str:
        """Draw separator and decimal mark of a text; a separator that its times contain is exchanged."""
        dialect = self.random.choice((",.", ",.", ";,", ";.", "\t.", "\t,", " .", "|."))
        if clock_kind in ("clock", "local date", "iso date", "german date") and dialect == " .":
            return ",."
        if clock_kind == "thousands" and dialect.startswith(","):
            return ";."
        return dialect

    def _style(self, container: str) -> str:
        styles = [style for style in VOCABULARIES if style != "none"]
        # Tables without names are texts and matrices; messages and columns of Parquet have names.
        if container in (*_TEXT_KINDS, "mat") and self.random.chance(0.12):
            return "none"
        return self.random.choice(styles)

    def _clock_kind(self, container: str) -> str:
        if container in _BAGS:
            return self.random.choice(("stamps", "stamps", "recorder", "two clocks"))
        if container in _TEXT_KINDS and self.random.chance(0.22):
            return self.random.weighted(_TEXT_CLOCKS)
        kind = self.random.weighted(_NUMERIC_CLOCKS)
        if container in ("xlsx", "parquet") and self.random.chance(0.25):
            return "datetime"
        return kind

    def _row_faults(self, container: str, clock_kind: str) -> list[str]:
        if self.random.chance(0.55):
            return []  # most files have no fault
        # Texts alone have lines. The rows of a bag are its messages, of which only lost ones are drawn.
        possible = [
            fault
            for fault in _ROW_FAULTS
            if (container in _TEXT_KINDS or fault not in _LINE_FAULTS)
            and (container not in _BAGS or fault in ("lost rows", "long gap"))
        ]
        if clock_kind in ("none", "rows"):
            possible = ["stalled values"]  # without times, other faults do not show
        if clock_kind not in _FINE_CLOCKS:
            unseen = ("reversed", "swapped rows", "lost rows", "long gap")
            possible = [fault for fault in possible if fault not in unseen]
        if self.style == "none":
            possible = [fault for fault in possible if fault != "repeated header"]
        count = 1 + self.random.chance(0.3) + self.random.chance(0.1)
        chosen: list[str] = []
        for _ in range(min(count, len(possible))):
            fault = self.random.choice([item for item in possible if item not in chosen])
            chosen.append(fault)
        if "reversed" in chosen:  # its report would cover swapped rows too
            chosen = [fault for fault in chosen if fault != "swapped rows"]
        return chosen

    def _refusal(self) -> str:
        """Draw what a file lacks, as a key of `_REFUSALS`; most files lack nothing."""
        if self.random.chance(0.1):
            kind = self.random.choice(("voltages", "voltages", "two angles"))
            self.traits.append("no voltages" if kind == "voltages" else "two angles only")
            return kind
        return ""

    def _sampled(self, clock_kind: str, container: str, faults: Sequence[str]) -> _Measured:
        """Sample the flight at the times of the rows."""
        flight = self.flight
        self.rate_Hz = self._sampling_rate_Hz(clock_kind, container)
        step_s = 1.0 / self.rate_Hz
        true_s = self._times_of_rows_s(clock_kind, step_s)
        true_s = self._without_lost_rows(true_s, faults)
        self.traits.append(f"{self.rate_Hz:g} Hz")
        # Half a step of the rows and the rounding of fine clocks, each with some reserve.
        self.time_tolerance_s = 0.004 + 0.6 * step_s
        # The logger has the last sample before each row; 1e-9 s is above the rounding of times.
        rows = np.clip(np.searchsorted(flight.t_s, true_s + 1e-9, side="right") - 1, 0, None)
        return _Measured(
            true_s,
            {axis: getattr(flight, f"{axis}_rad")[rows] for axis in AXES},
            {motor: getattr(flight, f"{motor}_V")[rows] for motor in MOTORS},
        )

    def _sampling_rate_Hz(self, clock_kind: str, container: str) -> float:
        """Draw a rate at which coarse times repeat, and whole milliseconds do not."""
        # Spreadsheets and bags are slow to write and to read, so they have fewer rows.
        rates_Hz = [rate for rate in _RATES_Hz if container != "xlsx" or rate <= 100.0]
        if container in _BAGS:
            rates_Hz = [rate for rate in rates_Hz if rate <= 250.0]
        if clock_kind in ("tenths", "whole seconds"):
            rates_Hz = [rate for rate in rates_Hz if rate >= 25.0]
        if clock_kind in ("ms", "overflow 16 ms", "epoch ms", "clock", "prefix"):
            rates_Hz = [rate for rate in rates_Hz if rate <= 500.0]
        return rates_Hz[int(self.random.rng.integers(len(rates_Hz)))]

    def _times_of_rows_s(self, clock_kind: str, step_s: float) -> Floats:
        """Draw which part of the flight is logged, and how evenly the rows follow each other."""
        random, flight = self.random, self.flight
        end_s = float(flight.t_s[-1])
        start_s = float(flight.t_s[0])
        if random.chance(0.3):
            start_s += random.between(2.0, 9.0)
            self.traits.append("begins in flight")
        duration_s = min(end_s - start_s, random.between(26.0, 45.0), _MAX_ROWS * step_s)
        count = int(duration_s / step_s)
        true_s = start_s + step_s * np.arange(count, dtype=np.float64)
        jitter = random.choice(("even", "even", "even", "jitter", "jitter", "lost time"))
        if clock_kind in ("rows", "none", "tenths", "whole seconds", "five digits"):
            jitter = "even"  # such clocks cannot show it
        if jitter == "jitter":
            true_s = true_s + step_s * random.between(0.02, 0.25) * random.rng.uniform(-1.0, 1.0, count)
        elif jitter == "lost time":
            # A loop that is late now and then, and does not catch up.
            late_s = step_s * random.rng.exponential(0.3, count) * (random.rng.random(count) < 0.03)
            true_s = true_s + np.cumsum(late_s)
        if jitter != "even":
            self.traits.append(jitter)
        return np.asarray(true_s[true_s < end_s])

    def _without_lost_rows(self, true_s: Floats, faults: Sequence[str]) -> Floats:
        """Remove the rows that the drawn faults lose: a few here and there, or all of some time."""
        random = self.random
        keep = np.ones(true_s.size, bool)
        if "lost rows" in faults:
            for _ in range(max(3, round(0.004 * true_s.size))):
                first = int(random.rng.integers(10, true_s.size - 10))
                keep[first : first + int(random.rng.integers(1, 4))] = False
        if "long gap" in faults:
            first = int(true_s.size * random.between(0.3, 0.7))
            gap_s = random.between(0.8, 2.5)
            keep &= ~((true_s > true_s[first]) & (true_s < true_s[first] + gap_s))
            self.lost_s += gap_s
        return np.asarray(true_s[keep])

    def _header(self, name: str, unit: str) -> tuple[str, str]:
        """Return the name with its unit, and the unit of the unit row."""
        word = self.random.choice(UNIT_WORDS[unit]) if unit in UNIT_WORDS else ""
        if self.unit_style == "tail":
            # A tail is a part of the name, as in `pitch_deg`: only letters are possible.
            word = {"°": "deg", "%": "percent", "1": "duty", "-": "duty", "µs": "us", "s": "s"}.get(
                word, word
            )
        if self.unit_style == "tail" and unit in ("s", "V", "A", "C"):
            return name, ""  # loggers with such names leave out the base units
        return with_unit(name, word, self.unit_style), word if self.unit_style == "row" else ""

    def _add(self, group: str, name: str, unit: str, values: Floats, decimals: int) -> None:
        full_name, unit_cell = self._header(name, unit)
        self.columns.append(LoggedColumn(full_name, unit_cell, values, decimals, group))

    def _angle_columns(self, measured: _Measured, refusal: str) -> None:
        """Add the columns of the angles, and note which facts about them the file does not show."""
        random = self.random
        self.angle_unit = random.choice(("rad", "deg", "deg", "deg", "count", "rad"))
        is_zero_on_table = self.recipe.starts_on_table and random.chance(0.3)
        left_out = random.choice(AXES[1:]) if refusal == "two angles" else ""
        for axis, word in zip(AXES, self.words.angles, strict=True):
            angle_rad = measured.angles_rad[axis]
            if axis == "elevation" and is_zero_on_table:
                angle_rad = angle_rad - self.flight.elevation_rad[0]
            logged, decimals = self._logged_angle(axis, angle_rad)
            if axis != left_out:
                self._add(axis, word, self.angle_unit, logged, decimals)
        if self.turned:
            self.traits.append(f"inverted {'+'.join(self.turned)}")
        if is_zero_on_table:
            self.traits.append("elevation 0 on the table")
        states_unit = self.unit_style != "none"
        self.traits.append(f"angles in {self.angle_unit}{'' if states_unit else ' unstated'}")
        if "pitch" in self.turned or "travel" in self.turned:
            self.unknown.append("mirror")
        if not self.recipe.starts_on_table or "begins in flight" in self.traits:
            self.unknown.append("zero")
        if not states_unit:
            self.unknown.append("scale")

    def _logged_angle(self, axis: str, angle_rad: Floats) -> tuple[Floats, int]:
        """Draw how the logger writes an angle: sign, zero, rounding and range; return values and decimals."""
        random = self.random
        is_turned = random.chance(0.15)
        if is_turned:
            self.turned.append(axis)
        if axis == "travel" and random.chance(0.4):
            angle_rad = angle_rad + random.between(-3.0, 3.0)
        counts = self.rig[f"encoder_counts_{axis}"].value
        per_rad = {"rad": 1.0, "deg": 180.0 / math.pi, "count": counts / (2.0 * math.pi)}[self.angle_unit]
        logged = (-1.0 if is_turned else 1.0) * angle_rad * per_rad
        # Both numbers of decimals are drawn in each case: the seeds' cases depend on the order of draws.
        drawn_decimals = {"rad": 4 + int(random.rng.integers(3)), "deg": 2 + int(random.rng.integers(3))}
        decimals = drawn_decimals.get(self.angle_unit, 0)
        self.value_step[axis] = 10.0**-decimals / per_rad
        if self.angle_unit == "count":
            logged = np.round(logged)
            if axis == "travel" and random.chance(0.3):
                # An unsigned 16-bit counter that starts near 0, so that it soon overflows downwards.
                logged = np.mod(logged + _FIRST_COUNT, 65536.0)
        elif axis == "travel" and random.chance(0.25):
            turn = 2.0 * math.pi * per_rad
            drawn_range_deg = random.choice(("0 to 360", "-180 to 180"))
            lowest = 0.0 if drawn_range_deg == "0 to 360" else -0.5 * turn
            logged = np.mod(logged - lowest, turn) + lowest
        return logged, decimals

    def _voltage_columns(self, measured: _Measured, refusal: str) -> tuple[str, str]:
        """Add the columns of the voltages; return what they hold, `MOTORS` or `SUMS`."""
        random, words = self.random, self.words
        front_V, back_V = measured.volts_V["front"], measured.volts_V["back"]
        weights = {"V": 0.58, "mV": 0.04, "percent": 0.14, "duty": 0.1, "pwm": 0.12, "pwm 1023": 0.02}
        unit = random.weighted(weights)
        roles, values_V = MOTORS, (front_V, back_V)
        if random.chance(0.16):
            roles, values_V = SUMS, (front_V + back_V, front_V - back_V)
            if random.chance(0.25):
                values_V = (0.5 * values_V[0], 0.5 * values_V[1])
                self.traits.append("half sums")
        decimals = {"V": 3, "mV": 0, "percent": 1, "duty": 4}.get(unit, 0)
        volts_per_unit = self._volts_per_unit(unit, row_count=front_V.size, decimals=decimals)
        self.voltage_unit = unit
        self.traits.append(f"{'+'.join(roles)} in {unit}")
        if unit not in ("V", "mV"):
            self.unknown.append("supply")
        if refusal == "voltages":
            return roles  # the file has none
        names = words.sums if roles == SUMS else tuple(words.voltage.format(motor) for motor in words.motors)
        if self.style == "numbered" and roles == MOTORS:
            self.unknown.append("columns")  # motor 1 may be the front or the back one
        stated_unit = unit.split()[0]  # "pwm 1023" is written as "pwm", so the import must find the range
        for role, voltage_name, volts_V in zip(roles, names, values_V, strict=True):
            name = voltage_name
            if stated_unit in ("percent", "duty", "pwm") and roles == MOTORS and self.style != "none":
                motor = words.motors[MOTORS.index(role)]
                name = words.duty.format(motor)
            self._add(role, name, stated_unit, volts_V / volts_per_unit, decimals)
        return roles

    def _volts_per_unit(self, unit: str, *, row_count: int, decimals: int) -> Floats:
        """Return the volts of a unit in each row; of duty cycles, they may follow a battery that sags."""
        random = self.random
        supply_V = self.rig["supply"].value
        nominal = {
            "V": 1.0,
            "mV": 1e-3,
            "percent": supply_V / 100.0,
            "duty": supply_V,
            "pwm": supply_V / 255.0,  # 8 bits
            "pwm 1023": supply_V / 1023.0,  # 10 bits
        }[unit]
        # The motor's voltage is the sum of both half sums, each with its own rounding.
        steps = 2.0 if "half sums" in self.traits else 1.0
        for motor in MOTORS:
            self.value_step[motor] = 10.0**-decimals * nominal * steps
        volts_per_unit = np.full(row_count, nominal)
        if unit not in ("V", "mV") and random.chance(0.35):
            battery = random.between(0.93, 1.04) - 0.03 * np.linspace(0.0, 1.0, row_count) ** 2
            self.battery_V = supply_V * battery
            volts_per_unit = volts_per_unit * self.battery_V / supply_V
            self.traits.append("supply column")
        return volts_per_unit

    def _extra_columns(self, measured: _Measured, refusal: str, roles: tuple[str, str]) -> None:
        """Add columns that the import must not mistake for angles or voltages."""
        random = self.random
        share = 0.08 if self.style == "none" else 0.3
        without_voltages = refusal == "voltages"
        setpoint_kind = random.choice(("steps", "smooth"))
        # Without voltages, a setpoint or a current must not be imported instead of them.
        wants_setpoints = random.chance(0.9 if without_voltages else share)
        wants_currents = random.chance(0.6 if without_voltages else share)
        if without_voltages and not wants_setpoints:
            wants_currents = True
        wants_duties = roles == MOTORS and not without_voltages and self.voltage_unit == "V"
        extras = [
            *self._columns_like_angles(measured, share, setpoint_kind if wants_setpoints else ""),
            *self._columns_like_voltages(measured, share, wants_currents, wants_duties),
            *self._other_columns(measured, share),
        ]
        if without_voltages and wants_currents and self.style == "none":
            self.unknown.append("currents")
        self.traits += dict.fromkeys(extras)  # without repeats, in their order

    def _columns_like_angles(self, measured: _Measured, share: float, setpoint_kind: str) -> list[str]:
        """Add columns that follow the angles; return their kinds. Without a kind, no setpoints are added."""
        random, words = self.random, self.words
        extras: list[str] = []
        # Only the encoders count; all other columns of a logger in counts are in degrees.
        unit = "deg" if self.angle_unit == "count" else self.angle_unit
        per_rad = {"rad": 1.0, "deg": 180.0 / math.pi}[unit]
        step_s = 1.0 / self.rate_Hz
        logged = {column.group for column in self.columns}
        for axis, word in zip(AXES, words.angles, strict=True):
            if axis not in logged:
                continue  # the angle that is left out
            angle_rad = measured.angles_rad[axis]
            sign = -1.0 if axis in self.turned else 1.0
            if setpoint_kind:
                extras.append("setpoints")
                setpoint = _setpoint(np.unwrap(angle_rad), step_s, setpoint_kind)
                self._add("extra", words.setpoint.format(word), unit, sign * setpoint * per_rad, 3)
            if random.chance(share):
                extras.append("filtered copies")
                low_passed = _low_passed(angle_rad, step_s, lag_s=random.between(0.02, 0.15))
                self._add("extra", words.filtered.format(word), unit, sign * low_passed * per_rad, 4)
            if random.chance(share):
                extras.append("rates")
                rate = np.gradient(_low_passed(angle_rad, step_s, lag_s=0.03), step_s)
                self._add("extra", words.rate.format(word), "", rate * per_rad, 3)
            if self.style not in ("none", "greek") and random.chance(0.5 * share):
                extras.append("raw counts")
                counts_per_rad = self.rig[f"encoder_counts_{axis}"].value / (2.0 * math.pi)
                self._add("extra", f"{word}_raw", "", np.round(angle_rad * counts_per_rad), 0)
        return extras

    def _columns_like_voltages(
        self, measured: _Measured, share: float, wants_currents: bool, wants_duties: bool
    ) -> list[str]:
        """Add columns that follow the voltages; return their kinds."""
        random, words = self.random, self.words
        extras: list[str] = []
        step_s = 1.0 / self.rate_Hz
        for motor, word in zip(MOTORS, words.motors, strict=True):
            volts_V = measured.volts_V[motor]
            if wants_currents:
                extras.append("currents")
                noise_A = 0.02 * random.rng.standard_normal(volts_V.size)
                current_A = 0.35 * _low_passed(volts_V, step_s, lag_s=0.05) + noise_A
                self._add("extra", words.current.format(word), "A", current_A, 3)
            if wants_duties and random.chance(0.5 * share):
                extras.append("duties next to voltages")
                duty_percent = volts_V / self.rig["supply"].value * 100.0
                self._add("extra", words.duty.format(word), "percent", np.round(duty_percent), 0)
        return extras

    def _other_columns(self, measured: _Measured, share: float) -> list[str]:
        """Add supply, temperature and a counter of rows; return the kinds that the traits name."""
        random, words = self.random, self.words
        row_count = measured.true_s.size
        extras: list[str] = []
        if self.battery_V is not None:
            noise_V = 0.01 * random.rng.standard_normal(row_count)
            self._add("extra", words.supply, "V", self.battery_V + noise_V, 2)
        elif random.chance(0.5 * share):
            extras.append("constant supply")
            self._add("extra", words.supply, "V", np.full(row_count, self.rig["supply"].value), 1)
        if random.chance(share):
            extras.append("temperature")
            walk_C = 24.0 + 0.004 * np.cumsum(random.rng.standard_normal(row_count))
            self._add("extra", words.temperature, "C", walk_C, 1)
        if random.chance(share):
            extras.append("counter")
            self._add("extra", words.counter, "", np.arange(float(row_count)), 0)
        return extras

    def _stall(self, measured: _Measured) -> None:
        """Let all angles keep their values for some time, as a logger does that misses its sensor."""
        random = self.random
        count = measured.true_s.size
        first = int(count * random.between(0.35, 0.75))
        stall_s = random.between(1.0, 4.0)
        stop = min(count - 2, first + round(stall_s * self.rate_Hz))
        for index, column in enumerate(self.columns):
            # The counts come from the same sensor.
            if column.group in AXES or column.name.endswith("_raw"):
                values = column.values.copy()
                values[first:stop] = values[first]
                self.columns[index] = replace(column, values=values)
        self.lost_s += float(measured.true_s[stop]) - float(measured.true_s[first])

    def _two_rates(
        self, container: str, measured: _Measured, refusal: str, samples: dict[str, Samples]
    ) -> bool:
        """Let the voltages be logged in every k-th row only, with empty cells or held values between."""
        if container not in (*_TEXT_KINDS, "parquet", "xlsx") or refusal or not self.random.chance(0.07):
            return False
        if self.rate_Hz < 100.0:
            return False
        every = int(self.random.rng.integers(2, 6))
        while self.rate_Hz / every < 25.0:
            every -= 1  # the voltages keep at least 25 Hz
        rows = np.arange(measured.true_s.size)
        is_sample = rows % every == int(self.random.rng.integers(every))
        is_held = self.random.chance(0.3)
        for index, column in enumerate(self.columns):
            if column.group in (*MOTORS, *SUMS):
                values = np.where(is_sample, column.values, np.nan)
                if is_held:
                    values = _held(values)
                self.columns[index] = replace(column, values=values)
        for motor in MOTORS:
            samples[motor] = Samples(measured.true_s[is_sample], measured.volts_V[motor][is_sample])
        self.traits.append(f"voltages every {every} rows{' held' if is_held else ''}")
        return not is_held

    def _known_columns(self, columns: Sequence[LoggedColumn], refusal: str) -> dict[str, str]:
        """Columns that a user has to state because the file has no names: by their numbers."""
        if self.style != "none" or refusal:
            return {}
        self.unknown.append("columns")
        return {column.group: str(index) for index, column in enumerate(columns) if column.group != "extra"}

    def _clocked(
        self, kind: str, container: str, measured: _Measured, columns: tuple[LoggedColumn, ...]
    ) -> tuple[Recording, float]:
        """Write the clock of each row as the logger does; return the rate too, if the user states it."""
        clock = self._clock(kind, measured.true_s)
        rate_Hz = 0.0
        name = self.words.counter if kind == "rows" else "" if kind == "none" else self.words.time
        if kind == "rows" or (kind == "none" and self.random.chance(0.7)):
            rate_Hz = self.rate_Hz
        if kind == "rows" and name:
            # The row numbers are the clock already; an extra counter has the same name.
            columns = tuple(column for column in columns if column.name != name)
        full_name, _ = self._header(name, clock.unit) if name else ("", "")
        has_names = self.style != "none"
        if clock.unit in ("ms", "us", "ns", "min") and self.unit_style in ("none", "row") and has_names:
            # A name without its unit leaves the unit to the steps, which only one unit fits.
            full_name = f"{name}_{clock.unit}" if self.random.chance(0.5) else name
        recording = Recording(
            f"log_{self.style.replace(' ', '_')}",
            clock_kind=kind,
            clock_name=full_name,
            clock_unit=clock.unit,
            clock=clock.values,
            clock_texts=clock.texts,
            clock_decimals=clock.decimals,
            true_s=measured.true_s,
            columns=columns,
            has_header=has_names,
            unit_row=self.unit_style == "row",
        )
        return recording, rate_Hz

    def _clock(self, kind: str, true_s: Floats) -> _Clock:
        """Write the time of each row in a `kind` of clock."""
        random = self.random
        # A clock begins with the flight, when the logger boots, or long before the flight.
        start = random.choice(("0", "0", "boot", "late"))
        offsets_s = {"0": 0.0, "boot": random.between(1.0, 90.0), "late": random.between(200.0, 4000.0)}
        t_s = true_s - true_s[0] + offsets_s[start]
        since_start_s = t_s - t_s[0]
        epoch_s = 1.70e9 + random.between(0.0, 6e7)  # November 2023 and the two years after it
        day_s = random.between(0.0, 80_000.0)
        if kind in ("s", "stamps", "recorder", "two clocks"):
            return _Clock(t_s, decimals=3 + int(random.rng.integers(4)))
        if kind in ("ms", "us", "ns"):
            per_s = {"ms": 1e3, "us": 1e6, "ns": 1e9}[kind]
            return _Clock(np.floor(t_s * per_s), kind, decimals=0)
        if kind == "min":
            return _Clock(t_s / 60.0, "min", decimals=7)
        if kind == "epoch s":
            return _Clock(epoch_s + t_s)
        if kind == "epoch ms":
            return _Clock(np.floor((epoch_s + t_s) * 1e3), "ms", decimals=0)
        if kind == "five digits":
            # With five digits, steps of 0.01 s or 0.1 s remain of so large times.
            offset_s = float(random.choice(("100", "1000"))) * random.between(1.0, 2.0)
            # Rounded for all containers: not each writes numbers as texts.
            values = np.array([float(f"{value:.5g}") for value in since_start_s + offset_s])
            self._note_repeats(values)
            return _Clock(values, decimals=-5)
        if kind in ("tenths", "whole seconds"):
            decimals = 1 if kind == "tenths" else 0
            values = np.round(t_s, decimals)
            self._note_repeats(values)
            return _Clock(values, decimals=decimals)
        if kind == "overflow 16 ms":
            remaining_ms = random.between(3e3, 2e4)  # Until the counter overflows
            values = np.floor(np.mod(np.floor(since_start_s * 1e3) + 2.0**16 - remaining_ms, 2.0**16))
            self._note_overflow(values)
            return _Clock(values, "ms", decimals=0)
        if kind == "overflow 32 us":
            remaining_us = random.between(3e6, 2e7)
            values = np.floor(np.mod(np.floor(since_start_s * 1e6) + 2.0**32 - remaining_us, 2.0**32))
            self._note_overflow(values)
            return _Clock(values, "us", decimals=0)
        if kind == "restart":
            first = int(true_s.size * random.between(0.35, 0.65))
            values = np.where(np.arange(true_s.size) < first, since_start_s, t_s - t_s[first])
            self.reports["restart"] = _REPORTS["restart"]
            return _Clock(values, decimals=3)
        if kind == "rows":
            return _Clock(np.arange(float(true_s.size)), "", decimals=0)
        if kind == "none":
            return _Clock(t_s)
        if kind == "datetime":
            return _Clock(epoch_s + t_s, "datetime")
        return _Clock(t_s, "", texts=_clock_texts(kind, t_s, day_s))

    def _note_overflow(self, clock: Floats) -> None:
        """Note that the counter overflows; a short file may end before."""
        if (np.diff(clock) < 0.0).any():
            self.reports["overflow"] = _REPORTS["overflow"]

    def _note_repeats(self, clock: Floats) -> None:
        """Note that times repeat, if the resolution of the clock is above the step of the rows."""
        if np.mean(np.diff(clock) == 0.0) > 0.02:
            self.reports["coarse"] = _REPORTS["coarse"]


def _setpoint(angle_rad: Floats, step_s: float, kind: str) -> Floats:
    """Make a setpoint that the angle follows with the lag of a closed loop."""
    lead = max(1, round(0.45 / step_s))
    smooth = _low_passed(_low_passed(angle_rad, step_s, 0.25)[::-1], step_s, 0.25)[::-1]
    ahead = np.concatenate((smooth[lead:], np.full(lead, smooth[-1])))
    if kind == "smooth":
        return ahead
    hold = max(1, round(2.5 / step_s))
    return np.asarray(np.round(ahead[np.arange(ahead.size) // hold * hold], 2))


def _low_passed(values: Floats, step_s: float, lag_s: float) -> Floats:
    """First-order low-pass filter that is settled at the first value."""
    from scipy.signal import lfilter

    keep = math.exp(-step_s / lag_s)
    filtered, _ = lfilter([1.0 - keep], [1.0, -keep], values, zi=[keep * values[0]])
    return np.asarray(filtered)


def _held(values: Floats) -> Floats:
    """Repeat the last value in empty cells; cells before the first value stay empty."""
    last = np.maximum.accumulate(np.where(np.isfinite(values), np.arange(values.size), -1))
    return np.where(last >= 0, values[np.maximum(last, 0)], np.nan)


def _clock_texts(kind: str, t_s: Floats, day_s: float) -> tuple[str, ...]:
    """Write times as texts."""
    if kind == "clock":
        of_day = [day_s + t for t in t_s - t_s[0]]
        return tuple(f"{int(t) // 3600:02d}:{int(t) // 60 % 60:02d}:{t % 60:06.3f}" for t in of_day)
    if kind == "prefix":
        return tuple(f"t={t:.3f}" for t in t_s)
    if kind == "thousands":
        return tuple(f"{t * 1e3 + 5e3:,.0f}" for t in t_s)
    start = datetime.datetime(2025, 3, 4, tzinfo=datetime.UTC) + datetime.timedelta(seconds=round(day_s, 3))
    formats = {
        "iso date": "%Y-%m-%dT%H:%M:%S.%f",
        "local date": "%d/%m/%Y %H:%M:%S.%f",
        "german date": "%d.%m.%Y %H:%M:%S,%f",
    }
    moments = [start + datetime.timedelta(seconds=float(t)) for t in t_s - t_s[0]]
    return tuple(moment.strftime(formats[kind])[:-3] for moment in moments)
