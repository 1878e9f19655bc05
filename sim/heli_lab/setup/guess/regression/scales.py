"""Find the unit of each column from the accelerations of the axes and the voltage at hover."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from heli_host.data.arrays import Floats
from heli_host.data.tables.table import ANGLE_UNITS, COUNT, SHARES, VOLTAGE_UNITS

from heli_lab.setup.guess import thresholds
from heli_lab.setup.guess.regression.reference import Reference

AXES: Final = ("elevation", "pitch", "travel")
_ANGLE_UNITS: Final = ("rad", "deg", COUNT, "turn", "mrad")
_VOLTAGE_UNITS: Final = ("V", "mV", "duty", "percent", "pwm")
_FULL_SCALES: Final = (255.0, 1023.0, 4095.0)
_RARE_UNIT_NATS: Final = {"turn": 3.0, "mrad": 3.0, "mV": 1.0, "percent": 1.0, "duty": 1.0}
"""Penalty of a rare unit that the file does not state [nats]."""
_MIXED_UNITS_NATS: Final = 3.0
"""Penalty of an angle whose unit differs from elevation's, unless it is stated [nats]."""
_MISSING_BIAS_NATS: Final = 4.0
"""Penalty of a sum that was logged without its bias [nats]."""
_HALVED_SUM_NATS: Final = 3.0
"""Penalty of half sums and half differences that no name states [nats]."""
_IMPLAUSIBLE_PEAK_NATS: Final = 6.0
"""Penalty of a voltage unit in which the peak is outside of the plausible shares of the supply [nats]."""
_PLAUSIBLE_PEAK_SHARES: Final = (0.16, 1.2)
"""Plausible peak voltages over the rig file's supply; the upper limit allows another supply."""
_MAX_SHARE: Final = 1.02
"""Upper limit for units that are shares of the supply: a share above 1 is impossible."""
_SATURATION_NATS: Final = 3.0
"""Penalty of a unit in which some commands exceed the supply [nats]. Set by judgement: such logs are
rarer than those of limited voltages."""
_COUNTS_TOLERANCE: Final = 0.01
"""Largest relative difference between the counts per turn of a column and of an encoder; usual counts,
powers of 2 and multiples of 100, differ by more."""
_QUANTISATION_NATS: Final = 3.0
"""Reward of an angle quantised by the encoder; penalty of whole numbers that are not counts [nats]."""


@dataclass(frozen=True)
class VoltageScale:
    """One possible unit of the voltage columns."""

    unit: str
    """unit, full_scale, factor, bias_removed: As `voltage`, `full_scale`, `factor` and `bias_removed` of
    `Scale`."""
    full_scale: float
    factor: float
    bias_removed: bool

    def volts(self, reference: Reference) -> float:
        """Volts per unit of the voltage columns."""
        return self.factor * volts_of(self.unit, self.full_scale, reference)


@dataclass(frozen=True)
class LimitedMotion:
    """Measured gains of the axes, if voltages above the supply are taken to be limited to it."""

    gain: Mapping[str, float]  # Acceleration per voltage of each axis, as in `MeasuredMotion`
    mean_sum: float  # Mean of the sum of the limited voltages in flight, in the unit of the columns
    log_likelihood_ratio: float
    """Log-likelihood of elevation and pitch with limited commands, less that with the commands as logged
    [nats]."""


@dataclass(frozen=True)
class MeasuredMotion:
    """Measured gains, ranges and steps of the assigned columns, from which their units are inferred.

    All values are in the units of the columns.
    """

    gain: Mapping[str, float]  # Gain of each axis as in `Reference.gain`; the sign is ignored
    mean_sum: float  # Mean of the sum of the voltages in flight
    peak: float  # Largest voltage of a motor
    quantisation_step: Mapping[str, float]  # Smallest step of each angle; 0 if the angle is not quantised
    integer_valued: Mapping[str, bool]  # Whether each angle has whole numbers only
    stated_units: Mapping[str, str]
    """Units that names or the file state, by axis and for `voltage`; empty if none is stated."""
    summed: bool  # Whether the voltages are sum and difference instead of front and back
    halved: bool = False  # Whether a name states that these are half sums or half differences
    limited: Mapping[VoltageScale, LimitedMotion] = field(default_factory=dict)
    """The motion with limited commands, for each unit in which some commands exceed the supply."""


@dataclass(frozen=True)
class Scale:
    """One choice of units for all columns, with its likelihood."""

    angles: Mapping[str, str]  # Unit of each axis
    voltage: str  # Unit of both voltages
    full_scale: float  # Value of full supply, for `pwm`
    factor: float  # 2 if the voltages are half sums and half differences, otherwise 1
    bias_removed: bool  # Whether the sum was logged without its bias
    log_likelihood: float  # Log-likelihood of this choice [nats]
    deviation_std: Mapping[str, float]
    """Deviation from the rig file in standard deviations, by axis and for `hover`."""

    @property
    def voltage_scale(self) -> VoltageScale:
        """Unit, factor and bias of the voltages."""
        return VoltageScale(self.voltage, self.full_scale, self.factor, self.bias_removed)

    @property
    def units(self) -> tuple[str, ...]:
        """Units and factors as a profile states them."""
        return (*self.angles.values(), self.voltage, str(self.full_scale), str(self.factor))

    def volts(self, reference: Reference) -> float:
        """Volts per unit of the voltage columns."""
        return self.factor * volts_of(self.voltage, self.full_scale, reference)


def scales(motion: MeasuredMotion, reference: Reference) -> list[Scale]:
    """Score all combinations of units of angles and voltages; return them, the most likely first."""
    ranked = []
    for choice in voltage_scales(motion.summed):
        mean_V = abs(motion.mean_sum * choice.volts(reference))
        if choice.bias_removed and choice not in motion.limited and mean_V > 0.5 * reference.hover_V:
            continue
        hover_std = _hover_deviation_std(choice, motion, reference)
        voltage_nats = _voltage_unit_score(choice, motion, reference) - 0.5 * hover_std**2
        for units in itertools.product(_ANGLE_UNITS, repeat=3):
            angles = dict(zip(AXES, units, strict=True))
            deviation_std = _gain_deviations(angles, choice, motion, reference)
            nats = voltage_nats - 0.5 * sum(deviation**2 for deviation in deviation_std.values())
            nats += sum(_angle_score(angles, axis, motion, reference) for axis in AXES)
            ranked.append(
                Scale(
                    angles,
                    choice.unit,
                    choice.full_scale,
                    choice.factor,
                    choice.bias_removed,
                    nats,
                    {"hover": hover_std, **deviation_std},
                )
            )
    return sorted(ranked, key=lambda scale: -scale.log_likelihood)


def _hover_deviation_std(choice: VoltageScale, motion: MeasuredMotion, reference: Reference) -> float:
    """Compare the measured voltage at hover with the rig file's; return the deviation in standard deviations,
    0 if the sum was logged without its bias.
    """
    if choice.bias_removed:
        return 0.0
    mean_sum = motion.limited.get(choice, motion).mean_sum
    return _deviation_std(mean_sum * choice.volts(reference), reference.hover_V, thresholds.HOVER_STD)


def _voltage_unit_score(choice: VoltageScale, motion: MeasuredMotion, reference: Reference) -> float:
    """Log-likelihood of a unit of the voltages [nats], by the header, the names and the voltages' range; the
    gains of the axes are scored separately.
    """
    stated, limited = motion.stated_units.get("voltage", ""), motion.limited.get(choice)
    nats = _unit_score(stated, choice.unit)
    if choice.bias_removed:
        nats -= _MISSING_BIAS_NATS
    has_factor_2 = choice.factor != 1.0
    if motion.summed and motion.halved != has_factor_2:
        nats -= _HALVED_SUM_NATS
    min_share, max_share = _PLAUSIBLE_PEAK_SHARES
    if choice.unit not in VOLTAGE_UNITS:
        max_share = _MAX_SHARE
    # A sum without its bias lacks half the bias in each motor.
    bias_V = 0.5 * reference.hover_V if choice.bias_removed else 0.0
    peak_share = (motion.peak * choice.volts(reference) + bias_V) / reference.supply_V
    if peak_share <= min_share or (peak_share >= max_share and limited is None):
        nats -= _IMPLAUSIBLE_PEAK_NATS
    if limited is not None:
        # A limit always removes peaks of noise, so a better fit may only cancel the penalty, not exceed it.
        nats += min(limited.log_likelihood_ratio, _SATURATION_NATS)
        nats -= 0.0 if stated else _SATURATION_NATS
    return nats


def _gain_deviations(
    angles: Mapping[str, str], choice: VoltageScale, motion: MeasuredMotion, reference: Reference
) -> dict[str, float]:
    """Compare each axis' measured gain with the rig file's; return deviations in standard deviations, by
    axis.
    """
    volts, gain = choice.volts(reference), motion.limited.get(choice, motion).gain
    rad = {axis: rad_of(angles[axis], axis, reference) for axis in AXES}
    measured = {
        "elevation": gain["elevation"] * rad["elevation"] / volts,
        "pitch": gain["pitch"] * rad["pitch"] / volts,
        "travel": motion.gain["travel"] * rad["travel"] / rad["pitch"],
    }
    return {
        axis: _deviation_std(measured[axis], reference.gain[axis], thresholds.GAIN_STD[axis]) for axis in AXES
    }


def _angle_score(angles: Mapping[str, str], axis: str, motion: MeasuredMotion, reference: Reference) -> float:
    """Log-likelihood of the unit of an axis [nats], by the column's name and quantisation."""
    stated, unit = motion.stated_units.get(axis, ""), angles[axis]
    nats = _unit_score(stated, unit) + _quantisation_score(motion, axis, unit, reference)
    return nats - (_MIXED_UNITS_NATS if not stated and unit != angles["elevation"] else 0.0)


def voltage_scales(summed: bool) -> list[VoltageScale]:
    """List all choices of the voltages' unit; `summed` voltages are sum and difference."""
    pwm_scales = [("pwm", full) for full in _FULL_SCALES]
    units = [(unit, 255.0) for unit in _VOLTAGE_UNITS if unit != "pwm"] + pwm_scales
    factors_and_bias = list(itertools.product((1.0, 2.0), (False, True))) if summed else [(1.0, False)]
    return [
        VoltageScale(unit, full_scale, factor, bias_removed)
        for unit, full_scale in units
        for factor, bias_removed in factors_and_bias
    ]


def volts_of(unit: str, full_scale: float, reference: Reference) -> float:
    """Volts per `unit`; `full_scale` is the value of full supply if the unit is ``pwm``."""
    if unit in VOLTAGE_UNITS:
        return VOLTAGE_UNITS[unit]
    return reference.supply_V / (full_scale if unit == "pwm" else SHARES[unit])


def rad_of(unit: str, axis: str, reference: Reference) -> float:
    """Radians per `unit` of an `axis`."""
    return 2.0 * math.pi / reference.counts[axis] if unit == COUNT else ANGLE_UNITS[unit]


def _deviation_std(measured: float, reference: float, std: float) -> float:
    """Logarithm of a measured value over the reference's, in units of its standard deviation `std`; 0 if the
    reference is 0.
    """
    return math.log(max(abs(measured), 1e-300) / abs(reference)) / std if reference else 0.0


def _unit_score(stated: str, unit: str) -> float:
    """Log-likelihood of a `unit` [nats], given the unit that the file states; empty if it states none."""
    if stated:
        return thresholds.UNIT_NATS if stated == unit else 0.0
    return -_RARE_UNIT_NATS.get(unit, 0.0)


def _quantisation_score(motion: MeasuredMotion, axis: str, unit: str, reference: Reference) -> float:
    """Log-likelihood of the `unit` of an axis [nats], by the quantisation step of its column.

    Whole numbers are counts. In another unit, a step that is one count of the rig's encoder is evidence for
    that unit.
    """
    if motion.integer_valued[axis]:
        return 0.0 if unit == COUNT else -_QUANTISATION_NATS
    if unit == COUNT:
        return -_QUANTISATION_NATS
    step = motion.quantisation_step[axis] * rad_of(unit, axis, reference)
    steps_per_turn = 2.0 * math.pi / step if step > 0.0 else 0.0
    is_rigs_encoder = (
        steps_per_turn > 0.0 and abs(steps_per_turn / reference.counts[axis] - 1.0) < _COUNTS_TOLERANCE
    )
    return _QUANTISATION_NATS if is_rigs_encoder else 0.0


def is_encoder(values: Floats, reference: Reference) -> bool:
    """Whether the `values` of a column are quantised by an encoder of the rig, in radians or degrees."""
    step = quantisation_step(values)
    if step == 0.0:
        return False
    return any(
        abs(turn / step / counts - 1.0) < _COUNTS_TOLERANCE
        for turn in (2.0 * math.pi, 360.0)
        for counts in reference.counts.values()
    )


def quantisation_step(values: Floats) -> float:
    """Find the quantisation step of a column, in its unit; 0 if the column is not quantised. Shapes:
    `values` (n,).

    A column is quantised if more than nine tenths of its small changes are multiples of the smallest one.
    """
    changes = np.abs(np.diff(values[np.isfinite(values)]))
    # Without the rounding errors of floats.
    changes = changes[changes > 1e-9 * max(1.0, float(np.ptp(values)))]
    if not changes.size:
        return 0.0
    smallest = float(changes.min())
    # The mean of all single steps has less rounding than the smallest change.
    step = float(changes[changes < 1.5 * smallest].mean())
    # A change of more than 20 steps contains the step's error 20 times, which exceeds the tolerance below.
    multiples = changes[changes < 20.0 * step] / step
    is_multiple = np.abs(multiples - np.round(multiples)) < 0.05
    return step if float(np.mean(is_multiple)) > 0.9 else 0.0
