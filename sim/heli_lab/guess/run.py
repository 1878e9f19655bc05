"""The guess, from beginning to end: a table and a rig in, a profile with its margin out."""

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
from heli_lab.guess.doubts import Signs, lags, role_doubts, scale_doubts, sign_doubts, zero
from heli_lab.guess.flown import fly_choices
from heli_lab.guess.motion import answers, rest_of, voltages
from heli_lab.guess.reference import Reference, reference_of
from heli_lab.guess.result import Ambiguity, Guess
from heli_lab.guess.roles import ColumnAssignment, RegressionFit, assignments, free_rows
from heli_lab.guess.scales import AXES, Motion, Scale, is_encoder, rad_of, scales, step_of
from heli_lab.guess.signals import Signals, signals_of
from heli_lab.guess.times import Clock, clock_of, longest_run, times_in_s

_ANGLE_UNITS: Final = frozenset({*ANGLE_UNITS, COUNT})
_VOLTAGE_UNITS: Final = frozenset({*VOLTAGE_UNITS, *SHARES})
_NO_RATE: Final = "give a column of times, or the rate with --rate"


def guess(table: Table, rig: Rig, rate_Hz: float | None = None) -> Guess:
    """Propose a profile for a table from names, ranges and physics.

    Parameters
    ----------
    table : Table
        The file.
    rig : Rig
        What is known of the rig: scales, table, encoders, supply. Only units and zeros depend on it.
    rate_Hz : float, optional
        Rows a second, for a table without times.

    Raises
    ------
    FlightDataError
        When no five columns of it are the angles and voltages of a helicopter, or nothing says how fast it
        was logged.
    """
    return flown(*proposed(table, rig, rate_Hz), rig)


def proposed(table: Table, rig: Rig, rate_Hz: float | None = None) -> tuple[Guess, Table]:
    """Propose what `guess`, of the same arguments, proposes before it flies: by a `rig`, and `rate_Hz` where
    a `table` has no times. The longest part of the table, which that is of, comes beside it.
    """
    table = table.aligned()
    reference = reference_of(rig)
    clock = Clock("", "s", True) if rate_Hz else clock_of(table)
    if not rate_Hz and (not clock.column or not clock.unit):
        raise FlightDataError(f"{table.source}: no column is the time ({clock.other})", _NO_RATE)
    t_s = np.arange(len(table)) / rate_Hz if rate_Hz else times_in_s(table, clock)
    table, t_s = longest_run(table, t_s)
    others = [name for name in table.columns if name != clock.column and not names.is_time(name)]
    signals = signals_of(table, t_s, others)
    encoders = {name for name in others if is_encoder(table.columns[name].values, reference)}
    ranked = assignments(signals, reference, encoders)
    if not ranked:
        raise FlightDataError(
            f"{table.source}: fewer than five columns vary", "give a flight: three angles and two voltages"
        )
    ranked, motion = _fitting(table, signals, ranked, reference)
    roles = ranked[0]
    doubts, evidence = role_doubts(ranked)
    if not clock.sure:
        doubts.append(
            Ambiguity(
                "the time", f"{clock.column} in {clock.unit}", clock.other or "something else", _NO_RATE
            )
        )
    possible = scales(motion, reference)
    scale = possible[0]
    doubts += scale_doubts(possible, motion, reference, rig)
    rad = {axis: rad_of(scale.angles[axis], axis, reference) for axis in AXES}
    bias = reference.hover_V / scale.volts(reference) if scale.biased else 0.0
    explained = answers(signals, roles, reference, rad, bias)
    signs = _signs(explained, roles)
    doubts += sign_doubts(explained, signs, roles)
    rest = rest_of(signals, roles.elevation, float(np.degrees(signs.elevation * rad["elevation"])))
    offset_deg, zero_doubts = zero(rest, reference)
    doubts += zero_doubts
    late_s, lag_doubts, lag_notes = lags(explained)
    doubts += lag_doubts
    profile = _profile(table, clock, rate_Hz, roles, scale, signs, reference, offset_deg, late_s)
    evidence += [_answer_sentence(axis, explained[axis]) for axis in AXES] + lag_notes
    evidence.append(
        f"hover: {abs(motion.level) * scale.volts(reference):.2f} V together, the "
        f"rig file says {reference.hover_V:.2f} V"
    )
    profile, clip_doubts = _clipped(table, profile, reference)
    return Guess(profile, (*doubts, *clip_doubts), tuple(evidence), nats=roles.nats), table


def _fitting(
    table: Table, signals: Signals, ranked: Sequence[ColumnAssignment], reference: Reference
) -> tuple[list[ColumnAssignment], Motion]:
    """Of assignments that move alike, those first whose columns accelerate as a rig can in some unit.

    Returns
    -------
    tuple of (list of Roles, Motion)
        The likeliest assignments, the likeliest first, with what units say among their nats; how the axes of
        that one move.
    """
    near = [roles for roles in ranked if ranked[0].nats - roles.nats < thresholds.FITTING_NATS]
    fits = []
    for roles in near[: thresholds.MOST_FITTED]:
        motion = _motion(table, signals, roles, answers(signals, roles, reference))
        nats = scales(motion, reference)[0].nats
        fits.append((replace(roles, nats=roles.nats + nats, physics=roles.physics + nats), motion))
    fits.sort(key=lambda each: -each[0].nats)
    return [roles_ for roles_, _ in fits], fits[0][1]


def _clipped(table: Table, profile: Profile, reference: Reference) -> tuple[Profile, list[Ambiguity]]:
    """Limit the voltages where a few are beyond the supply, as commands are before a clip."""
    limit = reference.supply_V
    sizes_V = [np.abs(flight.voltages_V) for flight in flights_of(table, profile)]
    largest = max(float(size_V.max()) for size_V in sizes_V)
    beyond = max(float(np.mean(size_V > limit)) for size_V in sizes_V)
    if largest < thresholds.CLIP_SHARE * limit or beyond > thresholds.MOST_CLIPPED:
        return profile, []
    doubt = Ambiguity(
        "the voltages' limit",
        f"clipped to {limit:g} V, the rig file's supply",
        f"as logged, up to {largest:.1f} V",
        "what acts is no more than the amplifier gives; set clip_V, or leave it out",
    )
    return replace(profile, clip_V=(-limit, limit)), [doubt]


def flown(guessed: Guess, table: Table, rig: Rig) -> Guess:
    """Fly what was `guessed` of a `table` through the baseline model of a `rig`, and
    every other choice of signs beside it.
    """
    longest = max(flights_of(table, guessed.profile), key=len)
    choices = fly_choices(longest, rig)
    doubts = list(guessed.doubts)
    if not choices:
        doubts.append(
            Ambiguity(
                "the signs", "as proposed", "any others", "too little of it is in the air to fly the model"
            )
        )
    else:
        second = min(choices[1:], key=lambda choice: choice.ratio)
        if second.ratio < thresholds.FLOWN_RATIO:
            doubts.append(
                Ambiguity(
                    "the signs",
                    "as proposed",
                    f"{second.name} the other way",
                    f"the baseline model flies both alike: errors in the ratio {second.ratio:.2f}",
                )
            )
        evidence = (
            f"flown through the baseline model: next best with {second.name} the other way, errors "
            f"{second.ratio:.1f} times as large"
        )
        guessed = replace(guessed, evidence=(*guessed.evidence, evidence))
    return replace(guessed, doubts=tuple(doubts), choices=choices)


def _motion(
    table: Table, signals: Signals, roles: ColumnAssignment, first: dict[str, RegressionFit]
) -> Motion:
    first_V, second_V = voltages(signals, roles)
    rows = free_rows(signals, roles.elevation)
    level = (
        float(np.mean(first_V[rows] if roles.summed else (first_V + second_V)[rows])) if rows.any() else 0.0
    )
    columns = dict(zip(AXES, (roles.elevation, roles.pitch, roles.travel), strict=True))
    values = {axis: table.columns[column].values for axis, column in columns.items()}
    stated = {axis: _unit(table, column, _ANGLE_UNITS) for axis, column in columns.items()}
    stated["voltage"] = next(
        filter(None, (_unit(table, column, _VOLTAGE_UNITS) for column in roles.voltages)), ""
    )
    return Motion(
        {axis: first[axis].gain for axis in AXES},
        level,
        _peak(first_V, second_V, roles.summed),
        {axis: step_of(values[axis]) for axis in AXES},
        {axis: bool(np.all(np.mod(values[axis][np.isfinite(values[axis])], 1.0) == 0.0)) for axis in AXES},
        stated,
        roles.summed,
        any(names.is_half(column) for column in roles.voltages),
    )


def _peak(first_V: Floats, second_V: Floats, summed: bool) -> float:
    """Largest voltage of a motor; of sum and difference half of what each reaches: a bias is not known."""
    peaks = [float(np.quantile(np.abs(values), 0.995)) for values in (first_V, second_V)]
    return max(peaks) * (0.5 if summed else 1.0)


def _unit(table: Table, column: str, known: frozenset[str]) -> str:
    unit = table.columns[column].unit or split_unit(column)[1]
    return unit if unit in known else ""


def _signs(explained: dict[str, RegressionFit], roles: ColumnAssignment) -> Signs:
    """The fewest changes after which everything agrees."""
    elevation = 1.0 if explained["elevation"].gain >= 0.0 else -1.0
    answers_difference = explained["pitch"].gain >= 0.0
    follows_pitch = explained["travel"].gain >= 0.0
    if answers_difference:
        return Signs(elevation, 1.0, 1.0 if follows_pitch else -1.0, False)
    if follows_pitch:
        return Signs(elevation, 1.0, 1.0, True)
    return Signs(elevation, -1.0, 1.0, False)


def _answer_sentence(axis: str, explained: RegressionFit) -> str:
    cause = {"elevation": "the sum of the voltages", "pitch": "their difference", "travel": "pitch"}[axis]
    way = "with" if explained.gain >= 0.0 else "against"
    return f"{axis} goes {way} {cause}: {explained.nats:.0f} nats"


def _profile(
    table: Table,
    clock: Clock,
    rate_Hz: float | None,
    roles: ColumnAssignment,
    scale: Scale,
    signs: Signs,
    reference: Reference,
    offset_deg: float,
    late_s: dict[str, float],
) -> Profile:
    columns = dict(zip(AXES, (roles.elevation, roles.pitch, roles.travel), strict=True))
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
        Voltage(column, scale.voltage, scale.full, reference.supply_V, polarity, factor=scale.factor)
        for column, polarity in zip(roles.voltages, roles.polarity, strict=True)
    ]
    if roles.summed:
        if scale.biased:
            pair[0] = replace(pair[0], offset_V=round(reference.hover_V, 3))
        if signs.swapped:
            pair[1] = replace(pair[1], sign=-pair[1].sign)
        named = dict(zip(("sum", "difference"), pair, strict=True))
    else:
        named = dict(zip(("front", "back"), pair[::-1] if signs.swapped else pair, strict=True))
    return Profile(
        angles,
        named,
        "" if rate_Hz else clock.column,
        clock.unit,
        rate_Hz or 0.0,
        about=f"guessed from {Path(table.source).name}",
    )
