"""Guess the profile of a table with the help of a rig file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np
from heli_host.arrays import Floats
from heli_host.errors import FlightDataError
from heli_host.tables import Angle, Profile, Table, Voltage, flights_of
from heli_host.tables.units import ANGLE_UNITS, COUNT, SHARES, VOLTAGE_UNITS, split_unit
from heli_sim.rig import Rig

from heli_lab.guess import names, thresholds
from heli_lab.guess.ambiguities import (
    SignChanges,
    assignment_ambiguities,
    elevation_zero,
    lag_ambiguities,
    sign_ambiguities,
    unit_ambiguities,
)
from heli_lab.guess.assignment import ColumnAssignment, RegressionFit, assignments, free_rows
from heli_lab.guess.axis_regression import axis_regressions, rest_elevation, voltages
from heli_lab.guess.reference import Reference, reference_of
from heli_lab.guess.result import Ambiguity, Guess
from heli_lab.guess.scales import AXES, MeasuredMotion, Scale, is_encoder, rad_of, scales, step_of
from heli_lab.guess.sign_trials import try_sign_choices
from heli_lab.guess.signals import Signals, column_signals
from heli_lab.guess.times import Clock, clock_of, longest_run, times_in_s

_ANGLE_UNITS: Final = frozenset({*ANGLE_UNITS, COUNT})
_VOLTAGE_UNITS: Final = frozenset({*VOLTAGE_UNITS, *SHARES})
_NO_RATE: Final = "give a column of times, or the sampling rate with --rate"


def guess(table: Table, rig: Rig, rate_Hz: float | None = None) -> Guess:
    """Propose a profile for a table from names, ranges and physics.

    Parameters
    ----------
    table : Table
        The file.
    rig : Rig
        Parameters, table angle, encoders and supply of the rig. Only units and zeros depend on them.
    rate_Hz : float, optional
        Sampling rate [Hz], for a table without times.

    Raises
    ------
    FlightDataError
        When the table has no five columns that can be the angles and voltages, or no times and no rate.
    """
    return check_by_simulation(*propose(table, rig, rate_Hz), rig)


def propose(table: Table, rig: Rig, rate_Hz: float | None = None) -> tuple[Guess, Table]:
    """Propose a profile without simulating it; the arguments are those of `guess`.

    Parameters
    ----------
    rate_Hz : float, optional
        Sampling rate [Hz], for a table without times.

    Returns
    -------
    tuple of (Guess, Table)
        The guess, and the longest part of the table with rising times, to which the guess applies.
    """
    table = table.aligned()
    reference = reference_of(rig)
    clock = Clock("", "s", True) if rate_Hz else clock_of(table)
    if not rate_Hz and (not clock.column or not clock.unit):
        raise FlightDataError(f"{table.source}: no column is the time ({clock.alternative})", _NO_RATE)
    t_s = np.arange(len(table)) / rate_Hz if rate_Hz else times_in_s(table, clock)
    table, t_s = longest_run(table, t_s)
    others = [name for name in table.columns if name != clock.column and not names.is_time(name)]
    signals = column_signals(table, t_s, others, {*reference.counts.values()})
    encoders = {name for name in others if is_encoder(table.columns[name].values, reference)}
    ranked = assignments(signals, reference, encoders)
    if not ranked:
        raise FlightDataError(
            f"{table.source}: fewer than five columns vary", "give a flight: three angles and two voltages"
        )
    ranked, motion = _rank_with_units(table, signals, ranked, reference)
    assignment = ranked[0]
    ambiguities, evidence = assignment_ambiguities(ranked)
    if not clock.sure:
        ambiguities.append(
            Ambiguity(
                "the time", f"{clock.column} in {clock.unit}", clock.alternative or "something else", _NO_RATE
            )
        )
    possible = scales(motion, reference)
    scale = possible[0]
    ambiguities += unit_ambiguities(possible, motion, reference, rig)
    rad = {axis: rad_of(scale.angles[axis], axis, reference) for axis in AXES}
    bias = reference.hover_V / scale.volts(reference) if scale.bias_removed else 0.0
    explained = axis_regressions(signals, assignment, reference, rad, bias)
    signs = _fewest_sign_changes(explained, assignment)
    ambiguities += sign_ambiguities(explained, signs, assignment)
    rest = rest_elevation(
        signals, assignment.elevation, float(np.degrees(signs.elevation * rad["elevation"]))
    )
    offset_deg, zero_ambiguities = elevation_zero(rest, reference)
    ambiguities += zero_ambiguities
    late_s, timing_ambiguities, lag_notes = lag_ambiguities(explained)
    ambiguities += timing_ambiguities
    profile = _profile(table, clock, rate_Hz, assignment, scale, signs, reference, offset_deg, late_s)
    evidence += [_regression_sentence(axis, explained[axis]) for axis in AXES] + lag_notes
    evidence.append(
        f"hover: the voltages add up to {abs(motion.mean_sum) * scale.volts(reference):.2f} V, and to "
        f"{reference.hover_V:.2f} V in the rig file"
    )
    profile, clip_ambiguities = _limit_to_supply(table, profile, reference)
    return Guess(
        profile, (*ambiguities, *clip_ambiguities), tuple(evidence), log_likelihood=assignment.log_likelihood
    ), table


def _rank_with_units(
    table: Table, signals: Signals, ranked: Sequence[ColumnAssignment], reference: Reference
) -> tuple[list[ColumnAssignment], MeasuredMotion]:
    """Rank the most likely assignments again, with the likelihood of their best units included.

    Returns
    -------
    tuple of (list of ColumnAssignment, MeasuredMotion)
        The assignments, the most likely first, and the motion of the axes for the first of them.
    """
    close = [
        assignment
        for assignment in ranked
        if ranked[0].log_likelihood - assignment.log_likelihood < thresholds.CANDIDATE_MARGIN_NATS
    ]
    fits = []
    for assignment in close[: thresholds.MAX_CANDIDATES]:
        motion = _measured_motion(
            table, signals, assignment, axis_regressions(signals, assignment, reference)
        )
        nats = scales(motion, reference)[0].log_likelihood
        fits.append(
            (
                replace(
                    assignment,
                    log_likelihood=assignment.log_likelihood + nats,
                    physics_log_likelihood=assignment.physics_log_likelihood + nats,
                ),
                motion,
            )
        )
    fits.sort(key=lambda fit: -fit[0].log_likelihood)
    return [assignment for assignment, _ in fits], fits[0][1]


def _limit_to_supply(table: Table, profile: Profile, reference: Reference) -> tuple[Profile, list[Ambiguity]]:
    """Clip the voltages to the supply if a few exceed it, as commands before saturation do."""
    limit = reference.supply_V
    sizes_V = [np.abs(flight.voltages_V) for flight in flights_of(table, profile)]
    largest = max(float(size_V.max()) for size_V in sizes_V)
    beyond = max(float(np.mean(size_V > limit)) for size_V in sizes_V)
    if largest < thresholds.CLIP_SHARE * limit or beyond > thresholds.MAX_CLIPPED_SHARE:
        return profile, []
    ambiguity = Ambiguity(
        "the voltages' limit",
        f"clipped to {limit:g} V, the rig file's supply",
        f"as logged, up to {largest:.1f} V",
        "the amplifier cannot give more than the supply; set clip_V to your limit, or remove it",
    )
    return replace(profile, clip_V=(-limit, limit)), [ambiguity]


def check_by_simulation(guessed: Guess, table: Table, rig: Rig) -> Guess:
    """Check the signs of a guess by simulation of the baseline model of a `rig`.

    Parameters
    ----------
    guessed : Guess
        A guess from `propose`.
    table : Table
        The table to which it applies.

    Returns
    -------
    Guess
        With the simulated sign choices, their evidence, and an ambiguity if another choice fits as well.
    """
    longest = max(flights_of(table, guessed.profile), key=len)
    choices = try_sign_choices(longest, rig)
    ambiguities = list(guessed.ambiguities)
    if not choices:
        ambiguities.append(
            Ambiguity(
                "the signs",
                "as proposed",
                "any other signs",
                "the flight is too short in the air to simulate the model",
            )
        )
    else:
        second = min(choices[1:], key=lambda choice: choice.error_ratio)
        if second.error_ratio < thresholds.AMBIGUOUS_ERROR_RATIO:
            ambiguities.append(
                Ambiguity(
                    "the signs",
                    "as proposed",
                    f"{second.name} with the opposite sign",
                    f"the baseline model fits both about equally well, error ratio {second.error_ratio:.2f}",
                )
            )
        evidence = (
            f"simulation with the baseline model: the second best choice inverts {second.name}, with errors "
            f"{second.error_ratio:.1f} times as large"
        )
        guessed = replace(guessed, evidence=(*guessed.evidence, evidence))
    return replace(guessed, ambiguities=tuple(ambiguities), sign_choices=choices)


def _measured_motion(
    table: Table, signals: Signals, assignment: ColumnAssignment, first: dict[str, RegressionFit]
) -> MeasuredMotion:
    first_V, second_V = voltages(signals, assignment)
    rows = free_rows(signals, assignment.elevation)
    level = (
        float(np.mean(first_V[rows] if assignment.summed else (first_V + second_V)[rows]))
        if rows.any()
        else 0.0
    )
    columns = dict(zip(AXES, (assignment.elevation, assignment.pitch, assignment.travel), strict=True))
    values = {axis: table.columns[column].values for axis, column in columns.items()}
    stated = {axis: _unit(table, column, _ANGLE_UNITS) for axis, column in columns.items()}
    stated["voltage"] = next(
        filter(None, (_unit(table, column, _VOLTAGE_UNITS) for column in assignment.voltages)), ""
    )
    return MeasuredMotion(
        {axis: first[axis].gain for axis in AXES},
        level,
        _peak_voltage(first_V, second_V, assignment.summed),
        {axis: step_of(values[axis]) for axis in AXES},
        {axis: bool(np.all(np.mod(values[axis][np.isfinite(values[axis])], 1.0) == 0.0)) for axis in AXES},
        stated,
        assignment.summed,
        any(names.is_half(column) for column in assignment.voltages),
    )


def _peak_voltage(first_V: Floats, second_V: Floats, summed: bool) -> float:
    """Largest voltage of a motor; half the largest sum or difference, because the bias is unknown."""
    peaks = [float(np.quantile(np.abs(values), 0.995)) for values in (first_V, second_V)]
    return max(peaks) * (0.5 if summed else 1.0)


def _unit(table: Table, column: str, known: frozenset[str]) -> str:
    unit = table.columns[column].unit or split_unit(column)[1]
    return unit if unit in known else ""


def _fewest_sign_changes(explained: dict[str, RegressionFit], assignment: ColumnAssignment) -> SignChanges:
    """Find the fewest changes of sign after which all axes follow their causes."""
    elevation = 1.0 if explained["elevation"].gain >= 0.0 else -1.0
    pitch_follows_difference = explained["pitch"].gain >= 0.0
    travel_follows_pitch = explained["travel"].gain >= 0.0
    if pitch_follows_difference:
        return SignChanges(elevation, 1.0, 1.0 if travel_follows_pitch else -1.0, False)
    if travel_follows_pitch:
        return SignChanges(elevation, 1.0, 1.0, True)
    return SignChanges(elevation, -1.0, 1.0, False)


def _regression_sentence(axis: str, explained: RegressionFit) -> str:
    cause = {"elevation": "the sum of the voltages", "pitch": "their difference", "travel": "pitch"}[axis]
    direction = "with" if explained.gain >= 0.0 else "against"
    return f"{axis} accelerates {direction} {cause}: {explained.log_likelihood_ratio:.0f} nats"


def _profile(
    table: Table,
    clock: Clock,
    rate_Hz: float | None,
    assignment: ColumnAssignment,
    scale: Scale,
    signs: SignChanges,
    reference: Reference,
    offset_deg: float,
    late_s: dict[str, float],
) -> Profile:
    columns = dict(zip(AXES, (assignment.elevation, assignment.pitch, assignment.travel), strict=True))
    sign = {"elevation": signs.elevation, "pitch": signs.pitch, "travel": signs.travel}
    angles = {
        axis: Angle(
            columns[axis],
            scale.angles[axis],
            reference.counts[axis],
            sign[axis],
            round(offset_deg, 3) if axis == "elevation" else 0.0,
            round(late_s[axis], 3),
        )
        for axis in AXES
    }
    pair = [
        Voltage(column, scale.voltage, scale.full_scale, reference.supply_V, polarity, factor=scale.factor)
        for column, polarity in zip(assignment.voltages, assignment.polarity, strict=True)
    ]
    if assignment.summed:
        if scale.bias_removed:
            pair[0] = replace(pair[0], offset_V=round(reference.hover_V, 3))
        if signs.motors_swapped:
            pair[1] = replace(pair[1], sign=-pair[1].sign)
        voltages_by_role = dict(zip(("sum", "difference"), pair, strict=True))
    else:
        voltages_by_role = dict(
            zip(("front", "back"), pair[::-1] if signs.motors_swapped else pair, strict=True)
        )
    return Profile(
        angles,
        voltages_by_role,
        "" if rate_Hz else clock.column,
        clock.unit,
        rate_Hz or 0.0,
        about=f"guessed from {Path(table.source).name}",
    )
