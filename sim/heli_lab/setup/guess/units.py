"""Find units, zero and limits: a stated unit decides; gains, hover voltage and table confirm it."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np
from heli_host.data.arrays import Floats
from heli_host.data.flight import MAX_ANGLE_RAD, MAX_VOLTAGE_V
from heli_host.data.tables import Profile, Table, flights_of
from heli_host.data.tables.table import ANGLE_UNITS, COUNT, SHARES, VOLTAGE_UNITS, split_unit
from heli_sim.rig import Rig

from heli_lab.setup.guess.columns import PreparedFile, stated_unit
from heli_lab.setup.guess.motion import (
    NO_LIMITS,
    REST_DURATION_S,
    Assignment,
    Reference,
    RegressionFit,
    VoltageLimits,
    axis_regressions,
    free_rows,
    pooled_fits,
    sum_and_difference,
)
from heli_lab.setup.guess.names import A_SUPPLY, AXES, is_half, meanings_of, unknown_unit_of
from heli_lab.setup.guess.result import DECISIVE_NATS, Ambiguity
from heli_lab.setup.guess.signals import SAMPLE_STEP_s, Signals, quantisation_step

_ANGLE_UNITS: Final = ("rad", "deg", COUNT, "turn", "mrad", "cdeg", "mdeg")
_WHOLE_UNITS: Final = frozenset({"mrad", "cdeg", "mdeg"})
"""Units in which programs log whole numbers that are no counts."""
_VOLTAGE_UNITS: Final = ("V", "mV", "duty", "percent", "pwm")
_FULL_SCALES: Final = (255.0, 1023.0, 4095.0)
_RARE_UNIT_NATS: Final = {
    "turn": 3.0,
    "mrad": 3.0,
    "cdeg": 3.0,
    "mdeg": 3.0,
    "mV": 1.0,
    "percent": 1.0,
    "duty": 1.0,
}
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
_IMPOSSIBLE_NATS: Final = 1000.0
"""Penalty of a unit in which an arm turns over, or a motor gets a voltage that no flight may have [nats]."""
_SATURATION_NATS: Final = 3.0
"""Penalty of a unit that is not stated and in which some commands exceed the supply [nats]. Set by judgement:
such logs are rarer than those of limited voltages."""
_COUNTS_TOLERANCE: Final = 0.01
"""Largest relative difference between the steps per turn of a column and the counts of an encoder."""
_QUANTISATION_NATS: Final = 3.0
"""Reward of an angle quantised by the encoder; penalty of whole numbers that are not counts [nats]."""
_GAIN_STD: Final = {"elevation": 0.5, "pitch": 0.7, "travel": 0.4}
"""Standard deviation of the logarithm of measured over modelled gain. On measured flights this logarithm is
up to 0.87 on pitch, 0.57 on elevation and 0.45 on travel. Smaller values give wrong units with a rough rig
file, larger ones do not distinguish counts from degrees."""
_HOVER_STD: Final = 0.25
"""Standard deviation of the logarithm of measured over modelled hover voltage. Measured and simulated flights
are within 0.15."""
_MAX_DEVIATION_STD: Final = 3.0
"""Deviation from the rig file, in standard deviations, from which on the guess reports that no unit fits."""
_DOUBTFUL_COUNTS_STD: Final = 1.2
"""The same of elevation from which on counts per turn are in doubt: half as many deviate by 1.4."""
_COMMON_GAIN: Final = 0.9
_COMMON_GAIN_SPREAD: Final = 0.9
"""Smallest mean of the logarithms of all axes' gains over the rig file's, and their largest range, from which
on the clock is in doubt: one that runs at half of the rate multiplies each gain by 4."""
_MAX_ALTERNATIVES: Final = 4
"""Largest number of other units that an ambiguity lists."""
REST_TOLERANCE_DEG: Final = 4.0
"""Largest difference between elevation at rest and the rig file's table angle, in addition to its tolerance
[deg]. Measured flights rest at -30.0 and -30.4 deg. Rest and level differ by 25 deg, so any value between 2
and 10 distinguishes them."""
_ZERO_DEG: Final = 0.5
"""Difference beyond the tolerance of the rig file's table angle from which on the zero is in doubt [deg]:
programs log angles in tenths of a degree or finer."""
_STILL_deg: Final = 0.5
"""Largest range of the elevation at rest [deg]: five counts of an encoder with 4096 per turn."""
_MIN_RISE_deg: Final = 5.0
"""Smallest difference between the median of a flight and its beginning [deg] for the beginning to be a rest
on the table. Rest and level differ by some 25 deg, so values up to 20 distinguish a rest from a hover."""
_LOWEST_deg: Final = 3.0
"""Largest elevation above the lowest of a flight [deg] that still counts as the lowest. Flights are some
25 deg above their rest, so values up to 20 distinguish them."""
_CENTRED_NATS: Final = 0.5
"""Evidence from which on shares of the supply may have their 0 V in the middle [nats]. Healthy logs have less
than -1, and centred ones of simulated flights 0.7 and more."""
_MAX_DUTY: Final = 2.2
"""Largest sum of two duty cycles; the rest is noise."""
_MIN_MEDIAN: Final = 0.12
"""Smallest median of a flight that does not begin at rest, as a share of the table's depth, from which on its
zero is in doubt: most pilots fly near level, and a zero at rest is a table's depth away."""
_MIN_CLIMB: Final = 0.5
"""Smallest climb from the table to the median of a flight, as a share of the table's depth below level. Most
pilots fly near level; a smaller climb may be one from a turning point in flight."""
_CLIP_SHARE: Final = 1.02
"""Share of the supply from which on a voltage is a command before saturation. Rounding stays below it."""
_CLIPPED_SHARES: Final = (0.002, 0.5)
"""Shares of rows beyond a limit between which commands are taken to be limited there. Fewer rows change no
gain; with more, the supply, a sign or a zero is wrong. Control loops with commands beyond the supply for 40 %
of the time still fly."""


@dataclass(frozen=True)
class Scale:
    """One choice of units for all columns, with its likelihood."""

    angles: Mapping[str, str]  # Unit of each axis
    voltage: str  # Unit of both voltages
    full_scale: float  # Value of full supply, for `pwm`
    factor: float  # 2 if the voltages are half sums and half differences, otherwise 1
    bias_removed: bool  # Whether the sum was logged without its bias
    log_likelihood: float = 0.0  # Log-likelihood of this choice [nats]
    deviation_std: Mapping[str, float] | None = None
    """Deviation from the rig file in standard deviations, by axis and for `hover`."""

    @property
    def units(self) -> tuple[str, ...]:
        """Units and factors as a profile states them."""
        return (*self.angles.values(), self.voltage, str(self.full_scale), str(self.factor))

    def volts(self, reference: Reference) -> float:
        """Volts per unit of the voltage columns."""
        if self.voltage in VOLTAGE_UNITS:
            return self.factor * VOLTAGE_UNITS[self.voltage]
        full_scale = self.full_scale if self.voltage == "pwm" else SHARES[self.voltage]
        return self.factor * reference.supply_V / full_scale

    def rad(self, reference: Reference) -> dict[str, float]:
        """Radians per unit of each angle's column, by axis."""
        return _rad_per_unit(self.angles, reference)

    def agrees(self, stated_units: Mapping[str, str]) -> bool:
        """Whether the units are those that the file states."""
        units = {**self.angles, "voltage": self.voltage}
        return all(stated_units.get(name, "") in ("", unit) for name, unit in units.items())

    def __str__(self) -> str:
        if len(set(self.angles.values())) == 1:
            angle_units = self.angles[AXES[0]]
        else:
            angle_units = ", ".join(f"{axis} in {unit}" for axis, unit in self.angles.items())
        halves = ", sum and difference by halves" if self.factor != 1.0 else ""
        return f"angles in {angle_units}, voltages in {self.voltage}{self.full_scale_text}{halves}"

    @property
    def full_scale_text(self) -> str:
        """Words for the value of full supply, if the voltages are in ``pwm``; otherwise empty."""
        return f" of {self.full_scale:g}" if self.voltage == "pwm" else ""


def _rad_per_unit(units: Mapping[str, str], reference: Reference) -> dict[str, float]:
    """Radians of the unit of each axis, by axis."""
    return {
        axis: 2.0 * math.pi / reference.counts[axis] if unit == COUNT else ANGLE_UNITS[unit]
        for axis, unit in units.items()
    }


@dataclass(frozen=True)
class MeasuredMotion:
    """Measured gains, ranges and steps of the assigned columns, from which their units are inferred.

    All values are in the units of the columns.
    """

    gain: Mapping[str, float]  # Size of the gain of each axis as in `Reference.gain`
    mean_sum: float  # Mean of the sum of the voltages in flight
    total: Floats  # total, difference: (n,): Sum and difference of the voltages
    difference: Floats
    quantisation_step: Mapping[str, float]  # Smallest step of each angle; 0 if the angle is not quantised
    integer_valued: Mapping[str, bool]  # Whether each angle has whole numbers only
    angle_range: Mapping[str, float]  # Difference between the largest and the smallest value of each angle
    stated_units: Mapping[str, str]
    """Units that names or the file state, by axis and for `voltage`; empty if none is stated."""
    summed: bool  # Whether the voltages are sum and difference instead of front and back
    halved: bool  # Whether a name states that these are half sums or half differences

    def supply_shares(self, scale: Scale, reference: Reference) -> Floats:
        """Larger voltage of the two motors over the supply, in the units of a scale, shape (n,)."""
        volts = scale.volts(reference)
        bias = reference.hover_V / volts * scale.bias_removed
        sizes_V: Floats = 0.5 * volts * (np.abs(self.total + bias) + np.abs(self.difference))
        return sizes_V / reference.supply_V

    def exceeds(self, scale: Scale, reference: Reference) -> bool:
        """Whether a few commands exceed the supply in the units of a scale, so that they act limited."""
        share_beyond = float(np.mean(self.supply_shares(scale, reference) > _CLIP_SHARE))
        min_share, max_share = _CLIPPED_SHARES
        return min_share < share_beyond <= max_share


def measured_motion(
    files: Sequence[PreparedFile], assignment: Assignment, reference: Reference
) -> MeasuredMotion:
    """Measure the motion of the assigned columns over all files of one rig."""
    first = files[0]
    regressions = pooled_fits([axis_regressions(file.signals, assignment, reference) for file in files])
    means = []
    sums_and_differences = [sum_and_difference(file.signals, assignment) for file in files]
    for file, (total, _) in zip(files, sums_and_differences, strict=True):
        rows = free_rows(file.signals, assignment.columns["elevation"])
        means.append(float(np.mean(total[rows])) if rows.any() else 0.0)
    columns = {axis: assignment.columns[axis] for axis in AXES}
    values = {axis: first.table.columns[column].values for axis, column in columns.items()}
    angle_units, voltage_units = frozenset(_ANGLE_UNITS), frozenset((*VOLTAGE_UNITS, *SHARES))
    stated = {axis: stated_unit(first.table, column, angle_units) for axis, column in columns.items()}
    voltage = [stated_unit(first.table, column, voltage_units) for column in assignment.voltages]
    peak = max(float(np.nanmax(np.abs(first.table.columns[name].values))) for name in assignment.voltages)
    if peak > _MAX_DUTY:
        # A name such as `front_duty` then means the quantity, in percent or in steps of a timer.
        voltage = [unit if unit != "duty" else "" for unit in voltage]
    return MeasuredMotion(
        gain={axis: abs(regressions[axis].gain) for axis in AXES},
        mean_sum=float(np.mean(means)),
        total=np.concatenate([total for total, _ in sums_and_differences]),
        difference=np.concatenate([difference for _, difference in sums_and_differences]),
        quantisation_step={axis: quantisation_step(values[axis]) for axis in AXES},
        integer_valued={
            axis: bool(np.all(np.mod(values[axis][np.isfinite(values[axis])], 1.0) == 0.0)) for axis in AXES
        },
        angle_range={
            axis: float(np.ptp(np.quantile(first.signals.raw[column], (0.01, 0.99))))
            for axis, column in columns.items()
        },
        stated_units={**stated, "voltage": voltage[0] or voltage[1]},
        summed=assignment.summed,
        halved=any(is_half(column) for column in assignment.voltages),
    )


def scales(motion: MeasuredMotion, reference: Reference) -> list[Scale]:
    """Score all combinations of units of angles and voltages; return them, the most likely first."""
    angle_choices = [
        _angle_choice(dict(zip(AXES, units, strict=True)), motion, reference)
        for units in itertools.product(_ANGLE_UNITS, repeat=3)
    ]
    ranked = []
    for choice in _voltage_choices(motion.summed):
        volts = choice.volts(reference)
        mean_V = abs(motion.mean_sum) * volts
        if choice.bias_removed and mean_V > 0.5 * reference.hover_V:
            continue  # this sum still has its bias
        hover_std = 0.0 if choice.bias_removed else _deviation_std(mean_V, reference.hover_V, _HOVER_STD)
        # Deviations are normally distributed: each costs half of its square.
        voltage_nats = _voltage_unit_nats(choice, motion, reference) - 0.5 * hover_std**2
        # A file has a thousand combinations for each of a few units: each unit's deviation is computed once.
        deviation_by_rad = {
            axis: {
                rad: _gain_deviation(motion.gain[axis] * rad / volts, axis, reference)
                for rad in {angles.rad[axis] for angles in angle_choices}
            }
            for axis in ("elevation", "pitch")
        }
        for angles in angle_choices:
            deviation_std = {
                "hover": hover_std,
                "elevation": deviation_by_rad["elevation"][angles.rad["elevation"]],
                "pitch": deviation_by_rad["pitch"][angles.rad["pitch"]],
                "travel": angles.travel_std,
            }
            nats = voltage_nats - 0.5 * sum(deviation_std[axis] ** 2 for axis in AXES)
            ranked.append(
                Scale(
                    angles.units,
                    choice.voltage,
                    choice.full_scale,
                    choice.factor,
                    choice.bias_removed,
                    log_likelihood=nats + angles.nats,
                    deviation_std=deviation_std,
                )
            )
    return sorted(ranked, key=lambda scale: -scale.log_likelihood)


def _voltage_choices(summed: bool) -> list[Scale]:
    """List all units of the voltages, with angles in radians; `summed` voltages may be halved or lack their
    bias.
    """
    units = [(unit, _FULL_SCALES[0]) for unit in _VOLTAGE_UNITS if unit != "pwm"]
    units += [("pwm", full_scale) for full_scale in _FULL_SCALES]
    factors, biases_removed = ((1.0, 2.0), (False, True)) if summed else ((1.0,), (False,))
    rad = dict.fromkeys(AXES, "rad")
    return [
        Scale(rad, unit, full_scale, factor, bias_removed)
        for (unit, full_scale), factor, bias_removed in itertools.product(units, factors, biases_removed)
    ]


class _AngleChoice(NamedTuple):
    """A unit for each angle, without regard to the voltages."""

    units: Mapping[str, str]  # By axis
    rad: Mapping[str, float]  # Radians per unit of each column, by axis
    nats: float  # Log-likelihood by names, quantisation and range
    travel_std: float  # Deviation of travel's gain, which is per unit of pitch, in standard deviations


def _angle_choice(units: Mapping[str, str], motion: MeasuredMotion, reference: Reference) -> _AngleChoice:
    rad = _rad_per_unit(units, reference)
    nats = sum(_angle_unit_nats(units, rad[axis], axis, motion, reference) for axis in AXES)
    gain = motion.gain["travel"] * rad["travel"] / rad["pitch"]
    travel_std = _gain_deviation(gain, "travel", reference)
    return _AngleChoice(units, rad, nats - _IMPOSSIBLE_NATS * _turns_over(rad, motion), travel_std)


def _voltage_unit_nats(choice: Scale, motion: MeasuredMotion, reference: Reference) -> float:
    """Log-likelihood of a unit of the voltages [nats], by names and the voltages' range; the gains of the
    axes are scored separately.
    """
    stated = motion.stated_units["voltage"]
    nats = 0.0 if stated else -_RARE_UNIT_NATS.get(choice.voltage, 0.0)
    if choice.bias_removed:
        nats -= _MISSING_BIAS_NATS
    if motion.summed and motion.halved != (choice.factor != 1.0):
        nats -= _HALVED_SUM_NATS
    shares = motion.supply_shares(choice, reference)
    if float(np.max(shares)) * reference.supply_V > MAX_VOLTAGE_V:
        return nats - _IMPOSSIBLE_NATS
    min_share, max_share = _PLAUSIBLE_PEAK_SHARES
    if choice.voltage not in VOLTAGE_UNITS:
        max_share = _MAX_SHARE
    # Half a percent of the rows may be outliers.
    peak_share = float(np.quantile(shares, 0.995))
    if min_share < peak_share < max_share:
        return nats
    if peak_share >= max_share and motion.exceeds(choice, reference):
        return nats - (0.0 if stated else _SATURATION_NATS)
    return nats - _IMPLAUSIBLE_PEAK_NATS


def _turns_over(rad: Mapping[str, float], motion: MeasuredMotion) -> bool:
    """Whether elevation or pitch moves farther in some units, `rad` radians each, than an arm can."""
    return any(
        rad[name.removesuffix("_rad")] * motion.angle_range[name.removesuffix("_rad")] > 2.0 * limit_rad
        for name, limit_rad in MAX_ANGLE_RAD.items()
    )


def _gain_deviation(gain: float, axis: str, reference: Reference) -> float:
    """Compare a measured gain of an axis with the rig file's; return the deviation in standard deviations."""
    return _deviation_std(gain, reference.gain[axis], _GAIN_STD[axis])


def _deviation_std(measured: float, reference: float, std: float) -> float:
    """Logarithm of a measured value over the reference's, in units of its standard deviation `std`; 0 if the
    reference is 0.
    """
    return math.log(max(abs(measured), 1e-300) / abs(reference)) / std if reference else 0.0


def _angle_unit_nats(
    units: Mapping[str, str], rad: float, axis: str, motion: MeasuredMotion, reference: Reference
) -> float:
    """Log-likelihood of the unit of an axis, `rad` radians, among the `units` of all axes [nats], by
    quantisation; whole numbers are counts.
    """
    unit = units[axis]
    nats = 0.0
    if not motion.stated_units[axis]:
        nats -= _RARE_UNIT_NATS.get(unit, 0.0)
        nats -= _MIXED_UNITS_NATS if unit != units["elevation"] else 0.0
    if motion.integer_valued[axis] and unit in _WHOLE_UNITS and motion.stated_units[axis]:
        return nats
    if motion.integer_valued[axis] or unit == COUNT:
        is_count = motion.integer_valued[axis] and unit == COUNT
        return nats if is_count else nats - _QUANTISATION_NATS
    step_rad = motion.quantisation_step[axis] * rad
    if not step_rad:
        return nats
    is_rigs_encoder = abs(2.0 * math.pi / step_rad / reference.counts[axis] - 1.0) < _COUNTS_TOLERANCE
    return nats + _QUANTISATION_NATS * is_rigs_encoder


def choose_scale(motion: MeasuredMotion, reference: Reference, rig: Rig) -> tuple[Scale, list[Ambiguity]]:
    """Choose the units: those that the file states, and otherwise those with gains most like the rig's."""
    ranked = scales(motion, reference)
    as_stated = [scale for scale in ranked if scale.agrees(motion.stated_units)] or ranked
    if ranked[0].log_likelihood - as_stated[0].log_likelihood > _IMPOSSIBLE_NATS / 2.0:
        # With the unit of the header, no flight could be written.
        as_stated = ranked
    best = as_stated[0]
    ambiguities = [
        *_contradicted_headers(best, ranked[0], motion),
        *_equally_likely_units(as_stated, motion, reference, rig),
        *_implausible_scales(best, rig),
        *_implausible_rate(best),
        *_missing_bias(best, reference),
        *_centred_shares(best, motion, reference),
        *_unknown_supply(as_stated, motion, reference),
    ]
    ambiguities += _doubtful_counts(best, reference, rig, {each.subject for each in ambiguities})
    return best, ambiguities + _whole_numbers(best, motion)


def _whole_numbers(best: Scale, motion: MeasuredMotion) -> list[Ambiguity]:
    """Report angles in whole numbers without a stated unit that the motion takes for other units than counts:
    an encoder with other counts per turn than the rig's has such numbers, too.
    """
    axes = [
        axis
        for axis, unit in best.angles.items()
        if motion.integer_valued[axis] and not motion.stated_units[axis] and unit != COUNT
    ]
    if len(axes) < 2:
        return []
    return [
        Ambiguity(
            "the units",
            str(best),
            "counts of an encoder with another number of counts per turn",
            f"{' and '.join(axes)} have whole numbers, and the file does not state their unit; state it in "
            "the header or the profile",
        )
    ]


def _doubtful_counts(best: Scale, reference: Reference, rig: Rig, subjects: set[str]) -> list[Ambiguity]:
    """Report the counts per turn of all angles if the motion contradicts the scale of one or does not show
    it, or elevation may have half or twice of them: a program that counts other edges does so everywhere.
    """
    counted = [axis for axis, unit in best.angles.items() if unit == COUNT]
    deviation_std = abs((best.deviation_std or {}).get("elevation", 0.0))
    # Voltages in an unknown unit show no gain, and so no scale.
    is_contradicted = "the voltages' unit" in subjects
    is_contradicted |= any({f"{axis}'s unit", f"the scale of {axis}"} & subjects for axis in counted)
    if len(counted) < 2 or not (is_contradicted or deviation_std > _DOUBTFUL_COUNTS_STD):
        return []
    return [
        Ambiguity(
            "the scale of the encoders",
            ", ".join(f"{axis} {reference.counts[axis]:g}" for axis in counted),
            "half, twice or four times as many",
            f"these are those of rig {rig.name}, and the motion may fit others as well; turn an axis by a "
            "known angle",
        )
    ]


def _contradicted_headers(best: Scale, by_motion: Scale, motion: MeasuredMotion) -> list[Ambiguity]:
    """Report each stated unit of which the motion fits another one decisively better."""
    is_followed = best.agrees(motion.stated_units)
    if is_followed and by_motion.log_likelihood - best.log_likelihood < DECISIVE_NATS:
        return []
    subjects = {axis: f"{axis}'s unit" for axis in AXES} | {"voltage": "the voltages' unit"}
    units = {**by_motion.angles, "voltage": by_motion.voltage}
    return [
        Ambiguity(
            subject,
            f"{motion.stated_units[name]}, as the header says" if is_followed else units[name],
            units[name] if is_followed else f"{motion.stated_units[name]}, as the header says",
            "the motion fits another unit than the header"
            if is_followed
            else "no arm moves as far as the header's unit says, and no motor gets such a voltage",
        )
        for name, subject in subjects.items()
        if motion.stated_units[name] not in ("", units[name])
    ]


def unknown_unit_ambiguities(assignment: Assignment, scale: Scale) -> list[Ambiguity]:
    """Report each column whose name states a unit that is not known; units by the motion alone are rough."""
    columns = [(f"{axis}'s unit", assignment.columns[axis], scale.angles[axis]) for axis in AXES]
    # Both voltages have the same unit: one unknown header is enough to report it.
    voltage = next(filter(unknown_unit_of, assignment.voltages), assignment.voltages[0])
    columns.append(("the voltages' unit", voltage, scale.voltage))
    return [
        Ambiguity(
            subject,
            unit,
            f"{unknown}, as the header says",
            f"'{unknown}' is no known unit, and the motion shows a unit only roughly; state it in a profile",
        )
        for subject, column, unit in columns
        if (unknown := unknown_unit_of(column))
    ]


def _equally_likely_units(
    possible: Sequence[Scale], motion: MeasuredMotion, reference: Reference, rig: Rig
) -> list[Ambiguity]:
    """Report the other units that are nearly as likely as the best ones, in one ambiguity."""
    best = possible[0]
    # Some choices have the same units, and differ only in whether the bias is removed: keep the most likely.
    others: dict[tuple[str, ...], Scale] = {}
    for scale in possible:
        if scale.units != best.units and best.log_likelihood - scale.log_likelihood < DECISIVE_NATS:
            others.setdefault(scale.units, scale)
    if not others:
        return []
    near = list(others.values())
    clipped = f", clipped to {reference.supply_V:g} V"
    texts = [
        f"{scale}{clipped if motion.exceeds(scale, reference) else ''}" for scale in near[:_MAX_ALTERNATIVES]
    ]
    return [
        Ambiguity(
            "the units",
            str(best),
            ", or ".join(texts),
            f"for rig {rig.name} they differ by only "
            f"{best.log_likelihood - near[0].log_likelihood:.1f} nats; "
            "state the unit in the header or the profile",
        )
    ]


def _implausible_scales(best: Scale, rig: Rig) -> list[Ambiguity]:
    """Report each quantity that differs much from the rig file even in the chosen unit."""
    deviations = dict(best.deviation_std or {})
    # Angles of which all are a fourth, as counts of another decoder are, contradict both gains a little.
    weights = {axis: 1.0 / _GAIN_STD[axis] for axis in ("elevation", "pitch")}
    joint = sum(weights[axis] * deviations.get(axis, 0.0) for axis in weights) / math.hypot(*weights.values())
    if max(map(abs, deviations.values()), default=0.0) <= _MAX_DEVIATION_STD < abs(joint):
        deviations["elevation"] = joint
    return [
        Ambiguity(
            f"the scale of {quantity}",
            str(best),
            f"a much {'larger' if deviation_std < 0 else 'smaller'} unit",
            f"even the best unit is {abs(deviation_std):.1f} standard deviations from rig "
            f"{rig.name}; give your rig with --rig",
        )
        for quantity, deviation_std in deviations.items()
        if abs(deviation_std) > _MAX_DEVIATION_STD
    ]


def _implausible_rate(best: Scale) -> list[Ambiguity]:
    """Report a clock with which all gains are the same multiple of the rig file's, and the hover is not."""
    deviations = best.deviation_std or {}
    logs = [deviations.get(axis, 0.0) * _GAIN_STD[axis] for axis in AXES]
    is_common = min(logs) * max(logs) > 0.0 and max(logs) - min(logs) < _COMMON_GAIN_SPREAD
    mean = sum(logs) / len(logs)
    if not is_common or abs(mean) < _COMMON_GAIN:
        return []  # the gains agree with the rig file's, or differ by more than a clock
    if abs(deviations.get("hover", 0.0)) > 1.0:
        return []  # the unit of the voltages would explain it, too
    return [
        Ambiguity(
            "the time",
            "as logged",
            f"about {math.exp(0.5 * mean):.1f} times as long",
            f"each axis accelerates about {math.exp(mean):.1f} times as much as the rig file says; measure "
            "the duration of a log with another clock",
        )
    ]


def _missing_bias(best: Scale, reference: Reference) -> list[Ambiguity]:
    """Report a sum that was logged without its bias."""
    if not best.bias_removed:
        return []
    chosen = f"{reference.hover_V:.2f} V, the rig file's hover voltage"
    reason = "the sum was logged without its bias; look up the bias and set offset_V"
    return [Ambiguity("the sum's bias", chosen, "another value", reason)]


def _centred_shares(best: Scale, motion: MeasuredMotion, reference: Reference) -> list[Ambiguity]:
    """Report shares of the supply that may have their 0 V in the middle."""
    if _centred_nats(best, motion, reference) <= _CENTRED_NATS:
        return []
    return [
        Ambiguity(
            "the voltages' unit",
            f"{best.voltage}{best.full_scale_text} from 0 V on",
            f"{best.voltage}{best.full_scale_text} with 0 V in its middle",
            "the voltages are never negative, and the motion fits a driver for both directions better; "
            "look up the value at rest",
        )
    ]


def _unknown_supply(
    possible: Sequence[Scale], motion: MeasuredMotion, reference: Reference
) -> list[Ambiguity]:
    """Report that the supply is unknown if the voltages are shares of it; `possible` begins with the best."""
    best = possible[0]
    if best.voltage not in SHARES or reference.supply_column:
        return []  # the voltages are in V, or the file contains the supply
    if motion.stated_units["voltage"]:
        # The gains differ too much from rig to rig to show a supply of 11 instead of 12 V.
        chosen = f"{reference.supply_V:g} V, as in the rig file"
        reason = "a share of the supply does not show it; measure the supply and set supply_V"
        return [Ambiguity("the supply voltage", chosen, "another supply", reason)]
    nats_in_volts = max((each.log_likelihood for each in possible if each.voltage == "V"), default=-math.inf)
    or_volts = ", or V" if best.log_likelihood - nats_in_volts < 2.0 * DECISIVE_NATS else ""
    chosen = f"{best.voltage}{best.full_scale_text}, a share of {reference.supply_V:g} V"
    reason = "the file does not state it; measure the supply and set supply_V"
    return [Ambiguity("the voltages' unit", chosen, f"a share of another supply{or_volts}", reason)]


def _centred_nats(best: Scale, motion: MeasuredMotion, reference: Reference) -> float:
    """Log-likelihood of shares of the supply whose middle is 0 V, as drivers for both directions have,
    against shares whose 0 is 0 V [nats].
    """
    is_negative = bool((motion.total < np.abs(motion.difference)).any())
    deviations = best.deviation_std
    if best.voltage not in SHARES or motion.summed or is_negative or deviations is None:
        return 0.0
    full_scale = best.full_scale if best.voltage == "pwm" else SHARES[best.voltage]
    # Half of the range is full supply, so that gains per volt are half of those of the other meaning.
    mean_V = 2.0 * best.volts(reference) * (abs(motion.mean_sum) - full_scale)
    centred = {axis: deviations[axis] - math.log(2.0) / _GAIN_STD[axis] for axis in ("elevation", "pitch")}
    centred["hover"] = _deviation_std(mean_V, reference.hover_V, _HOVER_STD) if mean_V > 0.0 else math.inf
    return 0.5 * sum(deviations[name] ** 2 - deviation**2 for name, deviation in centred.items())


_SUPPLY_SHARES: Final = (0.7, 1.4)
"""Range of a logged supply over the rig file's. Batteries are within 0.8 to 1.2; a supply of another part of
the rig, such as 5 V of the electronics, is far outside."""


def with_logged_supply(reference: Reference, files: Sequence[PreparedFile], hover_V: float) -> Reference:
    """Return the reference with the supply that the files log, for voltages that are shares of it.

    Without a single column that is named as a supply and has plausible values, it is unchanged. `hover_V` is
    the sum of the voltages in flight with the rig file's supply; a supply that explains it is plausible.
    """
    columns = files[0].table.columns
    meanings = meanings_of({name: column.unit for name, column in columns.items()})
    min_share, max_share = _SUPPLY_SHARES
    plausible_V: dict[str, float] = {}
    for name, meaning in meanings.items():
        if meaning.quantity != A_SUPPLY or any(name not in file.table.columns for file in files):
            continue  # a profile needs a column that all files have
        volts_per_unit = VOLTAGE_UNITS.get(columns[name].unit or split_unit(name)[1], 1.0)
        mean_V = volts_per_unit * float(np.nanmean(columns[name].values))
        share = mean_V / reference.supply_V
        if min_share < share < max_share or _explains_hover(share, hover_V, reference):
            plausible_V[name] = mean_V
    if len(plausible_V) != 1:
        return reference  # none, or no reason to prefer one of several
    ((name, mean_V),) = plausible_V.items()
    return replace(reference, supply_V=round(mean_V, 3), supply_column=name)


def _explains_hover(share: float, hover_V: float, reference: Reference) -> bool:
    """Whether a supply, as a `share` of the rig file's, brings the sum of the voltages in flight, `hover_V`
    with the rig file's supply, to the rig file's hover voltage.
    """
    if share <= 0.0 or hover_V <= 0.0:
        return False
    deviation_std = abs(_deviation_std(hover_V, reference.hover_V, _HOVER_STD))
    corrected_std = abs(_deviation_std(share * hover_V, reference.hover_V, _HOVER_STD))
    return corrected_std < min(1.0, deviation_std)


@dataclass(frozen=True)
class RestElevation:
    """Elevation at the beginning of a flight, where the arm may rest on its table."""

    deg: float | None  # Elevation at rest [deg], with its sign; None if the flight does not begin at rest
    median_deg: float  # Median of the elevation in the flight [deg]
    begins_lowest: bool  # Whether the flight begins at its lowest elevation


def rest_elevation(
    signals: Signals, columns: Mapping[str, str], deg_per_unit: Mapping[str, float]
) -> RestElevation:
    """Find the elevation at which the arm rests at the beginning of a flight, from the columns of the axes.

    At the turning point of a flight, elevation stands still for a moment, but the other axes do not.
    """
    elevation_deg = deg_per_unit["elevation"] * signals.raw[columns["elevation"]]
    # An unsigned counter that starts below 0 has an offset of one turn.
    elevation_deg = elevation_deg - 360.0 * np.round(np.median(elevation_deg) / 360.0)
    beginning_deg = elevation_deg[: round(REST_DURATION_S / SAMPLE_STEP_s)]
    median_deg = float(np.median(elevation_deg))
    start_deg = float(np.median(beginning_deg))
    moved_deg = [
        abs(deg_per_unit[axis]) * float(np.ptp(signals.raw[columns[axis]][: beginning_deg.size]))
        for axis in ("elevation", "pitch", "travel")
    ]
    is_at_rest = max(moved_deg) < _STILL_deg and abs(median_deg - start_deg) > _MIN_RISE_deg
    return RestElevation(
        deg=start_deg if is_at_rest else None,
        median_deg=median_deg,
        begins_lowest=start_deg < float(elevation_deg.min()) + _LOWEST_deg,
    )


def elevation_zero(rest: RestElevation, reference: Reference) -> tuple[float, list[Ambiguity]]:
    """Decide which angle to add to the elevation so that it is 0 at level [deg].

    Programs zero the elevation either at level or at rest on the table. The rest at the beginning of the
    flight shows which, because the rig file states the angle of the arm on its table.
    """
    table_deg, table_tolerance_deg = reference.rest_deg, reference.rest_tolerance_deg

    def unchanged(chosen: str, alternative: str, reason: str) -> tuple[float, list[Ambiguity]]:
        """Add nothing to the elevation, but report another zero."""
        return 0.0, [Ambiguity("the elevation's zero", chosen, alternative, reason)]

    if rest.deg is None:
        if abs(rest.median_deg) < _MIN_MEDIAN * abs(table_deg):
            return 0.0, []
        return unchanged(
            f"0 as it is, with {rest.median_deg:.0f} deg in flight",
            # A median of about the table's depth is that of a log whose zero is at rest.
            f"0 at rest, so {table_deg:g} deg to add"
            if 0.5 * abs(table_deg) < abs(rest.median_deg) < 2.0 * abs(table_deg)
            else f"{-rest.median_deg:.0f} deg to add, so that it flies at 0 deg",
            "the flight does not begin at rest; start logging while the arm is on the table",
        )
    climb_deg, to_table_deg = rest.median_deg - rest.deg, table_deg - rest.deg
    if climb_deg < _MIN_CLIMB * abs(table_deg):
        return unchanged(
            f"as it is, at the beginning {rest.deg:.1f} deg",
            f"{to_table_deg:.1f} deg to add, so that it begins at {table_deg:g} deg",
            f"the flight is only {climb_deg:.0f} deg above its beginning, which may be the table or the air; "
            "measure the angle at rest",
        )
    as_it_is = f"as it is, at rest {rest.deg:.1f} deg"
    rests_at_table = f"{to_table_deg:.1f} deg to add, so that it rests at {table_deg:g} deg"
    zero_at_level = abs(to_table_deg) < REST_TOLERANCE_DEG + table_tolerance_deg
    zero_at_rest = abs(rest.deg) < REST_TOLERANCE_DEG + table_tolerance_deg
    is_off_table = abs(to_table_deg) > _ZERO_DEG + table_tolerance_deg
    if rest.begins_lowest and zero_at_level and not zero_at_rest and is_off_table:
        return unchanged(
            as_it_is,
            rests_at_table,
            f"the rig file states the table at {table_deg:g} ± {table_tolerance_deg:g} deg; measure the "
            "angle at rest",
        )
    if rest.begins_lowest and zero_at_level != zero_at_rest:
        return (0.0 if zero_at_level else to_table_deg), []
    # A log that begins in flight may be zeroed there, and most pilots fly near level.
    flies_at_level = f", or {-rest.median_deg:.1f} deg to add, so that it flies at 0 deg"
    return unchanged(
        as_it_is,
        rests_at_table + ("" if rest.begins_lowest else flies_at_level),
        "with the rig file's table angle, neither level nor rest would be 0; measure the angle at rest",
    )


def supply_limits(scale: Scale, motion: MeasuredMotion, reference: Reference) -> VoltageLimits:
    """Return the smallest and the largest voltage of a motor, in the unit of the columns.

    The limits are minus and plus the supply if some commands exceed it, otherwise infinite.
    """
    limit = reference.supply_V / scale.volts(reference)
    return VoltageLimits(-limit, limit) if motion.exceeds(scale, reference) else NO_LIMITS


def one_way_nats(
    regress: Callable[[VoltageLimits], Mapping[str, RegressionFit]], limits: VoltageLimits
) -> float:
    """Log-likelihood ratio of motors that do not reverse against motors within the limits [nats]."""
    reversing, one_way = regress(limits), regress(limits._replace(low=0.0))
    return sum(
        one_way[axis].log_likelihood_ratio - reversing[axis].log_likelihood_ratio
        for axis in ("elevation", "pitch")
    )


def limited(
    tables: Sequence[Table], profile: Profile, reference: Reference, nats_for_one_way: Callable[[], float]
) -> tuple[Profile, list[Ambiguity]]:
    """Add voltage limits to a profile, so that commands are clipped to what the amplifier gives."""
    supply_ambiguities: list[Ambiguity] = []
    # A share of a supply that was logged row by row cannot exceed it.
    if not reference.supply_column:
        profile, supply_ambiguities = _clipped_to_supply(tables, profile, reference.supply_V)
    profile, zero_ambiguities = _clipped_to_zero(tables, profile, reference, nats_for_one_way)
    return profile, supply_ambiguities + zero_ambiguities


def _voltages_V(tables: Sequence[Table], profile: Profile) -> Floats:
    """Return the voltages of all flights of the tables [V], shape (n, 2)."""
    return np.concatenate([flight.voltages_V for table in tables for flight in flights_of(table, profile)])


def _clipped_to_zero(
    tables: Sequence[Table], profile: Profile, reference: Reference, nats_for_one_way: Callable[[], float]
) -> tuple[Profile, list[Ambiguity]]:
    """Clip negative voltages of a profile to 0 V if the rig's motors do not reverse and the motion does not
    contradict it; report it if the motion may be that of motors that do not reverse.
    """
    volts_V = _voltages_V(tables, profile)
    share_below = float(np.mean(volts_V < (1.0 - _CLIP_SHARE) * reference.supply_V))
    # Rotors that push down most of the time cannot fly: then signs or zeros are wrong, not the limits.
    min_share, max_share = _CLIPPED_SHARES
    if not min_share <= share_below <= max_share:
        return profile, []
    nats = nats_for_one_way()
    # If the rig file says that motors do not reverse, only clear evidence to the contrary keeps the commands.
    if nats < (DECISIVE_NATS if reference.reverses else -DECISIVE_NATS):
        return profile, []
    # A reversed propeller may hardly push although its driver reverses, so the motion alone clips nothing. In
    # a rig file whose reversed rotors do not push, clipped commands fly like the commands themselves.
    is_clipped = not reference.reverses
    top_V = max(reference.supply_V, math.ceil(volts_V.max()))
    values = ("clipped to 0 V", f"as logged, down to {volts_V.min():.1f} V")
    chosen, alternative = values if is_clipped else values[::-1]
    ambiguity = Ambiguity(
        "the voltages' lower limit",
        chosen,
        alternative,
        f"{100.0 * share_below:.1f} % of the rows are below 0 V, and the motion is {abs(nats):.1f} nats "
        f"{'for' if nats >= 0.0 else 'against'} motors that do not push when reversed; if yours cannot "
        f"reverse, set clip_V to [0, {top_V:g}]",
    )
    return (replace(profile, clip_V=(0.0, top_V)) if is_clipped else profile), [ambiguity]


def _clipped_to_supply(
    tables: Sequence[Table], profile: Profile, limit_V: float
) -> tuple[Profile, list[Ambiguity]]:
    """Clip the voltages of a profile to the supply, `limit_V`, if a few exceed it; report it if any does."""
    sizes_V = np.abs(_voltages_V(tables, profile))
    largest_V = float(sizes_V.max())
    share_beyond = float(np.mean(sizes_V > _CLIP_SHARE * limit_V))
    if largest_V < _CLIP_SHARE * limit_V:
        return profile, []
    clipped = f"clipped to {limit_V:g} V, the rig file's supply"
    as_logged = f"as logged, up to {largest_V:.1f} V"
    _, max_share = _CLIPPED_SHARES
    if share_beyond > max_share:
        reason = (
            f"{100.0 * share_beyond:.0f} % of the rows exceed the supply; set clip_V, or give your rig with "
            "--rig"
        )
        return profile, [Ambiguity("the voltages' limit", as_logged, clipped, reason)]
    reason = "the amplifier cannot give more than the supply; set clip_V to your limit, or remove it"
    ambiguity = Ambiguity("the voltages' limit", clipped, as_logged, reason)
    return replace(profile, clip_V=(-limit_V, limit_V)), [ambiguity]
