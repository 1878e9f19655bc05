"""Guess the profile of a table with the help of a rig file."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from heli_host.errors import FlightDataError
from heli_host.tables import Angle, Profile, Table, Voltage, flights_of
from heli_sim.rig import Rig

from heli_lab.guess import thresholds
from heli_lab.guess.ambiguities import (
    SignChanges,
    assignment_ambiguities,
    elevation_zero,
    lag_ambiguities,
    sign_ambiguities,
    sum_ambiguities,
    unit_ambiguities,
)
from heli_lab.guess.evidence import (
    PreparedFile,
    common_candidates,
    pooled_fits,
    pooled_scales,
    prepare_file,
    rank,
)
from heli_lab.guess.known import NOTHING_KNOWN, KnownEntries
from heli_lab.guess.mirror import prefers_mirror, travel_torque_nats
from heli_lab.guess.refusals import check_voltages, names_state_voltages, too_few_columns
from heli_lab.guess.regression.assignment import ColumnAssignment, RegressionFit
from heli_lab.guess.regression.axis_regression import (
    RestElevation,
    axis_regressions,
    rest_elevation,
    sum_and_difference,
)
from heli_lab.guess.regression.candidates import feedback_sign
from heli_lab.guess.regression.reference import Reference, reference_of
from heli_lab.guess.regression.scales import AXES, Scale, rad_of
from heli_lab.guess.regression.signals import filtered_signal
from heli_lab.guess.result import Ambiguity, Guess
from heli_lab.guess.sign_trials import try_sign_choices
from heli_lab.guess.times import NO_RATE, Clock


def guess(table: Table, rig: Rig, rate_Hz: float | None = None) -> Guess:
    """Propose a profile for a table from names, ranges and physics.

    Parameters
    ----------
    rig : Rig
        Parameters, table angle, encoders and supply of the rig. Only units and zeros depend on them.
    rate_Hz : float, optional
        Sampling rate [Hz], for a table without times.

    Raises
    ------
    FlightDataError
        When the table has no five columns that can be the angles and voltages, or no times and no rate.
    """
    guessed, parts = propose([table], rig, rate_Hz)
    return check_by_simulation(guessed, parts, rig)[0]


def propose(
    tables: Sequence[Table], rig: Rig, rate_Hz: float | None = None, known: KnownEntries = NOTHING_KNOWN
) -> tuple[Guess, list[Table]]:
    """Propose one profile for the files of one rig, without simulating it.

    The evidence of all files is added up. Names and the rig's deviation from its rig file count once,
    because all files share them.

    Parameters
    ----------
    rig : Rig
        Rig file, as in `guess`.
    rate_Hz : float, optional
        Sampling rate [Hz], for tables without times.
    known : KnownEntries
        Entries of the profile that the user knows.

    Returns
    -------
    tuple of (Guess, list of Table)
        The guess, and the longest part of each table with rising times, to which the guess applies.
    """
    reference = reference_of(rig)
    files = [prepare_file(known.with_units(table.aligned()), reference, rate_Hz) for table in tables]
    first = files[0]
    clock, clock_ambiguities = _common_clock(files)
    columns, dropped = common_candidates(files, known.columns)
    if len(columns) < len(AXES) + 2:
        raise too_few_columns(first.table.source, columns, dropped)
    ranked, motions = rank(files, columns, reference, known)
    assignment = ranked[0]
    ambiguities, evidence = assignment_ambiguities(ranked)
    ambiguities += clock_ambiguities
    possible = pooled_scales(motions, reference)
    scale = possible[0]
    ambiguities += unit_ambiguities(possible, motions[0], reference, rig)
    rad = {axis: rad_of(scale.angles[axis], axis, reference) for axis in AXES}
    bias = reference.hover_V / scale.volts(reference) if scale.bias_removed else 0.0
    limited = any(scale.voltage_scale in motion.limited for motion in motions)
    limit = reference.supply_V / scale.volts(reference) if limited else math.inf
    explained = pooled_fits(
        [axis_regressions(file.signals, assignment, reference, rad, bias, limit) for file in files]
    )
    if not names_state_voltages(assignment) and not known.voltages:
        check_voltages(first.table.source, explained, assignment)
        ambiguities += sum_ambiguities(explained, assignment, columns, dropped)
    signs = fewest_sign_changes(explained, _feedback(files, assignment, bias, limit), known)
    torques_nats = [
        travel_torque_nats(file.signals, assignment, reference, rad, signs.travel) for file in files
    ]
    torque_nats = float(np.mean(torques_nats))
    mirrored = prefers_mirror(signs, torque_nats) if known.mirrored is None else known.mirrored
    ambiguities += sign_ambiguities(explained, signs, assignment, torque_nats, mirrored, rig)
    unit_deg = float(np.degrees(signs.elevation * rad["elevation"]))
    offset_deg, zero_ambiguities = elevation_zero(_rest(files, assignment, unit_deg), reference)
    timing_ambiguities, lag_sentence = lag_ambiguities(explained)
    ambiguities += zero_ambiguities + timing_ambiguities
    profile = known.applied(
        Profile(
            _angles(assignment, scale, signs, reference, offset_deg),
            _voltages(assignment, scale, signs, reference),
            "" if rate_Hz else clock.column,
            clock.unit,
            rate_Hz or 0.0,
            about=f"guessed from {Path(first.table.source).name}",
            mirrored=mirrored,
        )
    )
    if dropped:
        evidence.append("left out: " + ", ".join(f"{name} ({reason})" for name, reason in dropped.items()))
    evidence += [_regression_sentence(axis, explained[axis]) for axis in AXES] + [lag_sentence]
    evidence.append(
        f"hover: the voltages add up to {abs(motions[0].mean_sum) * scale.volts(reference):.2f} V, and to "
        f"{reference.hover_V:.2f} V in the rig file"
    )
    parts = [file.table for file in files]
    if profile.clip_V is None:
        profile, clip_ambiguities = _limit_to_supply(parts, profile, reference)
        ambiguities += clip_ambiguities
    ambiguities = [ambiguity for ambiguity in ambiguities if not known.states(ambiguity)]
    likelihood = assignment.log_likelihood
    return Guess(profile, tuple(ambiguities), tuple(evidence), log_likelihood=likelihood), parts


def _feedback(
    files: Sequence[PreparedFile], assignment: ColumnAssignment, bias: float, limit: float
) -> float:
    """Sum of the signs of elevation's feedback in the files, from -1 to 1 in each."""
    return sum(
        feedback_sign(
            filtered_signal(sum_and_difference(file.signals, assignment, bias, limit)[0]).value,
            file.signals.filtered[assignment.elevation],
            file.signals.counts_per_turn,
        )
        for file in files
    )


def _rest(files: Sequence[PreparedFile], assignment: ColumnAssignment, unit_deg: float) -> RestElevation:
    """Elevation at rest, of the first file that begins at rest at its lowest point."""
    rests = [rest_elevation(file.signals, assignment.elevation, unit_deg) for file in files]
    return next((rest for rest in rests if rest.deg is not None and rest.lowest), rests[0])


def _common_clock(files: Sequence[PreparedFile]) -> tuple[Clock, list[Ambiguity]]:
    """Return the times of the files, which have to be in the same column and unit, and if they are unsure."""
    first = files[0]
    for file in files[1:]:
        if (file.clock.column, file.clock.unit) != (first.clock.column, first.clock.unit):
            raise FlightDataError(
                f"{file.table.source}: its times differ from those of {first.table.source} "
                f"('{file.clock.column}' in {file.clock.unit}, '{first.clock.column}' in {first.clock.unit})",
                "import files of different programs one by one",
            )
    clock = first.clock
    if clock.sure:
        return clock, []
    other = clock.alternative or "something else"
    return clock, [Ambiguity("the time", f"{clock.column} in {clock.unit}", other, NO_RATE)]


def _limit_to_supply(
    tables: Sequence[Table], profile: Profile, reference: Reference
) -> tuple[Profile, list[Ambiguity]]:
    """Clip the voltages to the supply if a few exceed it, as commands before saturation do."""
    limit = reference.supply_V
    sizes_V = [np.abs(flight.voltages_V) for table in tables for flight in flights_of(table, profile)]
    largest = max(float(size_V.max()) for size_V in sizes_V)
    beyond = float(np.mean(np.concatenate(sizes_V) > thresholds.CLIP_SHARE * limit))
    if largest < thresholds.CLIP_SHARE * limit:
        return profile, []
    if beyond > thresholds.MAX_CLIPPED_SHARE:
        return profile, [
            Ambiguity(
                "the voltages' limit",
                f"as logged, up to {largest:.1f} V",
                f"clipped to {limit:g} V, the rig file's supply",
                f"{100.0 * beyond:.0f} % of the rows exceed the supply; set clip_V, or give your rig with "
                "--rig",
            )
        ]
    ambiguity = Ambiguity(
        "the voltages' limit",
        f"clipped to {limit:g} V, the rig file's supply",
        f"as logged, up to {largest:.1f} V",
        "the amplifier cannot give more than the supply; set clip_V to your limit, or remove it",
    )
    return replace(profile, clip_V=(-limit, limit)), [ambiguity]


def check_by_simulation(guessed: Guess, tables: Sequence[Table], rig: Rig) -> list[Guess]:
    """Check the signs of a guess by simulation of the baseline model of a `rig`.

    Parameters
    ----------
    guessed : Guess
        A guess from `propose`.
    tables : sequence of Table
        The tables to which it applies.

    Returns
    -------
    list of Guess
        One per table, with its simulated sign choices. All have an ambiguity if another choice fits
        about as well in the mean of all tables.
    """
    longest = [max(flights_of(table, guessed.profile), key=len) for table in tables]
    choices = [try_sign_choices(flight, rig) for flight in longest]
    simulated = [trials for trials in choices if trials]
    if not simulated:
        ambiguity = Ambiguity(
            "the signs",
            "as proposed",
            "any other signs",
            "the flight is too short in the air to simulate the model",
        )
        return [guessed.with_ambiguity(ambiguity) for _ in tables]
    log_ratios = np.mean(
        [[math.log(choice.error_ratio) for choice in trials] for trials in simulated], axis=0
    )
    second = int(np.argmin(log_ratios[1:])) + 1
    name, ratio = simulated[0][second].name, math.exp(float(log_ratios[second]))
    if ratio < thresholds.AMBIGUOUS_ERROR_RATIO:
        guessed = guessed.with_ambiguity(
            Ambiguity(
                "the signs",
                "as proposed",
                f"{name} with the opposite sign",
                f"the baseline model fits both about equally well, error ratio {ratio:.2f}",
            )
        )
    evidence = (
        f"simulation with the baseline model: the second best choice inverts {name}, with errors "
        f"{ratio:.1f} times as large"
    )
    guessed = replace(guessed, evidence=(*guessed.evidence, evidence))
    return [replace(guessed, sign_choices=trials) for trials in choices]


def fewest_sign_changes(
    explained: Mapping[str, RegressionFit], feedback: float, known: KnownEntries
) -> SignChanges:
    """Find the fewest changes of sign after which all axes follow their causes, and which agree with `known`.

    Parameters
    ----------
    feedback : float
        Positive if the sum of the voltages grows with the rate of elevation, negative if it falls,
        otherwise 0.
    """
    elevation = 1.0 if explained["elevation"].gain >= 0.0 else -1.0
    if feedback and explained["elevation"].log_likelihood_ratio < thresholds.DECISIVE_NATS:
        # A loop that flies is stable: the sum is minus a gain times the rate.
        elevation = -float(np.sign(feedback))
    with_difference = 1.0 if explained["pitch"].gain >= 0.0 else -1.0
    with_pitch = 1.0 if explained["travel"].gain >= 0.0 else -1.0
    # Pitch, travel and the motors have two choices of signs, which are mirror images.
    pitch = with_difference if with_difference > 0.0 or with_pitch < 0.0 else 1.0
    if known.sign("pitch"):
        pitch = known.sign("pitch")
    elif known.sign("travel"):
        pitch = with_pitch * known.sign("travel")
    elif known.motors:
        pitch = with_difference
    return SignChanges(elevation, pitch, with_pitch * pitch, with_difference * pitch < 0.0)


def _regression_sentence(axis: str, explained: RegressionFit) -> str:
    cause = {"elevation": "the sum of the voltages", "pitch": "their difference", "travel": "pitch"}[axis]
    direction = "with" if explained.gain >= 0.0 else "against"
    return f"{axis} accelerates {direction} {cause}: {explained.log_likelihood_ratio:.0f} nats"


def _angles(
    assignment: ColumnAssignment, scale: Scale, signs: SignChanges, reference: Reference, offset_deg: float
) -> dict[str, Angle]:
    return {
        axis: Angle(
            getattr(assignment, axis),
            scale.angles[axis],
            reference.counts[axis],
            getattr(signs, axis),
            round(offset_deg, 3) if axis == "elevation" else 0.0,
        )
        for axis in AXES
    }


def _voltages(
    assignment: ColumnAssignment, scale: Scale, signs: SignChanges, reference: Reference
) -> dict[str, Voltage]:
    pair = [
        Voltage(column, scale.voltage, scale.full_scale, reference.supply_V, polarity, factor=scale.factor)
        for column, polarity in zip(assignment.voltages, assignment.polarity, strict=True)
    ]
    if assignment.summed:
        if scale.bias_removed:
            pair[0] = replace(pair[0], offset_V=round(reference.hover_V, 3))
        if signs.motors_swapped:
            pair[1] = replace(pair[1], sign=-pair[1].sign)
        return dict(zip(("sum", "difference"), pair, strict=True))
    return dict(zip(("front", "back"), pair[::-1] if signs.motors_swapped else pair, strict=True))
