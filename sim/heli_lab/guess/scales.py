"""Which unit each column is in: how fast the axes accelerate and what holds the arm up tell."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from heli_host.arrays import Floats
from heli_host.tables.units import ANGLE_UNITS, COUNT, SHARES, VOLTAGE_UNITS

from heli_lab.guess import thresholds
from heli_lab.guess.reference import Reference

AXES: Final = ("elevation", "pitch", "travel")
_ANGLES: Final = ("rad", "deg", COUNT, "turn", "mrad")
_VOLTAGES: Final = ("V", "mV", "duty", "percent", "pwm")
_FULLS: Final = (255.0, 1023.0, 4095.0)
_UNUSUAL: Final = {"turn": 3.0, "mrad": 3.0, "mV": 1.0, "percent": 1.0}
"""Nats that a unit costs that nobody stated and few people use."""
_MIXED: Final = 3.0
"""Nats that an angle costs whose unit is another than elevation's, unless it is stated."""
_BIAS: Final = 4.0
"""Nats that it costs that a sum was logged without its bias."""
_HALVED: Final = 3.0
"""Nats that it costs that sum and difference were logged by halves, as mean and offset of it, where no name
says so."""
_PEAK: Final = 6.0
"""Nats that a unit costs in which no motor ever gets a sixth of its supply, or one gets more than all."""
_PEAKS: Final = (0.16, 1.2)
"""Shares of the supply, as the rig file has it."""
_MOST_SHARE: Final = 1.02
"""The same of what is written as a share: more than all is none, whatever the supply."""
_GRID: Final = 3.0
"""Nats for an angle in steps of the encoder's count, and against one in whole numbers that is no count."""


@dataclass(frozen=True)
class Motion:
    """How the axes were seen to accelerate, in the columns' own units.

    Parameters
    ----------
    gain : Mapping[str, float]
        By axis, as in `Reference.gain`, in units of the columns, without sign.
    level : float
        Mean of the sum of the voltages in flight.
    peak : float
        Largest voltage that a motor gets, as far as that is known.
    step : Mapping[str, float]
        Smallest step of each angle; 0 where there is none.
    whole : Mapping[str, bool]
        Whether an angle has whole numbers only.
    stated : Mapping[str, str]
        Units that names or the file state, by role: the axes and `voltage`.
    summed : bool
        Whether the voltages are sum and difference.
    halved : bool
        Whether a name says that these are halves.
    """

    gain: Mapping[str, float]
    level: float
    peak: float
    step: Mapping[str, float]
    whole: Mapping[str, bool]
    stated: Mapping[str, str]
    summed: bool
    halved: bool = False


@dataclass(frozen=True)
class Scale:
    """Units of all columns.

    Parameters
    ----------
    angles : Mapping[str, str]
        Unit by axis.
    voltage : str
        Unit of both voltages.
    full : float
        What full supply is written as, for `pwm`.
    factor : float
        2 where sum and difference are halves, else 1.
    biased : bool
        Whether the sum lacks its bias.
    nats : float
        Log-likelihood.
    off : Mapping[str, float]
        By how many standard deviations each scale is off what the rig file says: the axes and `hover`.
    """

    angles: Mapping[str, str]
    voltage: str
    full: float
    factor: float
    biased: bool
    nats: float
    off: Mapping[str, float]

    @property
    def units(self) -> tuple[str, ...]:
        """All that a profile says of it."""
        return (*self.angles.values(), self.voltage, str(self.full), str(self.factor))

    def volts(self, reference: Reference) -> float:
        """Volts that one of the voltages' unit is, by the `reference`."""
        return self.factor * volts_of(self.voltage, self.full, reference)


def scales(motion: Motion, reference: Reference) -> list[Scale]:
    """All choices of units, the likeliest first."""
    ranked = []
    fulls = [("pwm", full) for full in _FULLS]
    voltages = [(unit, 255.0) for unit in _VOLTAGES if unit != "pwm"] + fulls
    kinds = list(itertools.product((1.0, 2.0), (False, True))) if motion.summed else [(1.0, False)]
    for (unit, full), (factor, biased) in itertools.product(voltages, kinds):
        volts = factor * volts_of(unit, full, reference)
        hover = 0.0 if biased else _off(motion.level * volts, reference.hover_V, thresholds.HOVER_STD)
        base = -0.5 * hover**2 - (_BIAS if biased else 0.0) + _said(motion.stated.get("voltage", ""), unit)
        if motion.summed and motion.halved != (factor != 1.0):
            base -= _HALVED
        most = _PEAKS[1] if unit in VOLTAGE_UNITS else _MOST_SHARE
        if not _PEAKS[0] < motion.peak * volts / reference.supply_V < most:
            base -= _PEAK
        if biased and abs(motion.level * volts) > 0.5 * reference.hover_V:
            continue
        for units in itertools.product(_ANGLES, repeat=3):
            angles = dict(zip(AXES, units, strict=True))
            rad = {axis: rad_of(angles[axis], axis, reference) for axis in AXES}
            off = {
                "hover": hover,
                "elevation": _off(
                    motion.gain["elevation"] * rad["elevation"] / volts,
                    reference.gain["elevation"],
                    thresholds.GAIN_STD["elevation"],
                ),
                "pitch": _off(
                    motion.gain["pitch"] * rad["pitch"] / volts,
                    reference.gain["pitch"],
                    thresholds.GAIN_STD["pitch"],
                ),
                "travel": _off(
                    motion.gain["travel"] * rad["travel"] / rad["pitch"],
                    reference.gain["travel"],
                    thresholds.GAIN_STD["travel"],
                ),
            }
            nats = base - 0.5 * sum(off[axis] ** 2 for axis in AXES)
            for axis in AXES:
                stated = motion.stated.get(axis, "")
                nats += _said(stated, angles[axis]) + _grid(motion, axis, angles[axis], rad[axis], reference)
                if not stated and angles[axis] != angles["elevation"]:
                    nats -= _MIXED
            ranked.append(Scale(angles, unit, full, factor, biased, nats, off))
    return sorted(ranked, key=lambda scale: -scale.nats)


def volts_of(unit: str, full: float, reference: Reference) -> float:
    """Volts that one of a `unit` is, `full` being what full supply is written as."""
    if unit in VOLTAGE_UNITS:
        return VOLTAGE_UNITS[unit]
    return reference.supply_V / (full if unit == "pwm" else SHARES[unit])


def rad_of(unit: str, axis: str, reference: Reference) -> float:
    """Radians that one of a `unit` of an `axis` is."""
    return 2.0 * math.pi / reference.counts[axis] if unit == COUNT else ANGLE_UNITS[unit]


def _off(seen: float, known: float, std: float) -> float:
    return math.log(max(abs(seen), 1e-300) / abs(known)) / std if known else 0.0


def _said(stated: str, unit: str) -> float:
    if stated:
        return thresholds.UNIT_NATS if stated == unit else 0.0
    return -_UNUSUAL.get(unit, 0.0)


def _grid(motion: Motion, axis: str, unit: str, rad: float, reference: Reference) -> float:
    if motion.whole[axis]:
        return 0.0 if unit == COUNT else -_GRID
    if unit == COUNT:
        return -_GRID
    step = motion.step[axis] * rad
    turn = 2.0 * math.pi / step if step > 0.0 else 0.0
    return _GRID if turn and abs(turn / reference.counts[axis] - 1.0) < 0.01 else 0.0


def is_encoder(values: Floats, reference: Reference) -> bool:
    """Whether a column, `values`, is in steps of one of the rig's encoders, in radians or degrees."""
    step = step_of(values)
    turns = (2.0 * math.pi, 360.0) if step > 0.0 else ()
    return any(
        abs(turn / step / counts - 1.0) < 0.01 for turn in turns for counts in {*reference.counts.values()}
    )


def step_of(values: Floats) -> float:
    """Smallest step of a column, `values`, that is in steps; 0 where it is not."""
    moves = np.abs(np.diff(values[np.isfinite(values)]))
    moves = moves[moves > 1e-9 * max(1.0, float(np.ptp(values)))]
    if not moves.size:
        return 0.0
    step = float(moves.min())
    step = float(moves[moves < 1.5 * step].mean())
    multiples = moves[moves < 20.0 * step] / step
    return step if float(np.mean(np.abs(multiples - np.round(multiples)) < 0.05)) > 0.9 else 0.0
