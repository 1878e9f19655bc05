"""Guess the profile of a table with the help of a rig file."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from heli_host.data.tables import Angle, Profile, Table, Voltage, flights_of
from heli_host.errors import FlightDataError
from heli_sim.rig import Rig

from heli_lab.setup.guess import thresholds
from heli_lab.setup.guess.ambiguities import (
    SignChanges,
    assignment_ambiguities,
    sign_ambiguities,
    unit_ambiguities,
    voltage_ambiguities,
)
from heli_lab.setup.guess.elevation_zero import RestElevation, elevation_zero, rest_elevation
from heli_lab.setup.guess.evidence import (
    PreparedFile,
    common_candidates,
    pooled_fits,
    pooled_scales,
    prepare_file,
    rank,
)
from heli_lab.setup.guess.known import NOTHING_KNOWN, KnownEntries
from heli_lab.setup.guess.lags import lag_ambiguities
from heli_lab.setup.guess.limits import limited, one_way_nats, supply_limits
from heli_lab.setup.guess.mirror import prefers_mirror, travel_torque_nats
from heli_lab.setup.guess.refusals import check_voltages, names_state_voltages, too_few_columns
from heli_lab.setup.guess.regression.acceleration_fit import RegressionFit
from heli_lab.setup.guess.regression.assignment import ColumnAssignment
from heli_lab.setup.guess.regression.axis_regression import axis_regressions, sum_and_difference
from heli_lab.setup.guess.regression.candidates import feedback_sign
from heli_lab.setup.guess.regression.reference import Reference, reference_of
from heli_lab.setup.guess.regression.scales import AXES, MeasuredMotion, Scale, rad_of
from heli_lab.setup.guess.regression.signals import filtered_signal
from heli_lab.setup.guess.result import Ambiguity, Guess
from heli_lab.setup.guess.sign_trials import try_sign_choices
from heli_lab.setup.guess.times import NO_RATE, Clock


def guess(table: Table, rig: Rig, rate_Hz: float | None = None) -> Guess:
    """Guess column, unit, sign and zero of each angle and voltage of a table, from names, ranges and physics.

    Parameters
    ----------
    table : Table
        Log of another program.
    rig : Rig
        Parameters, table angle, encoders and supply of the rig. Only units and zeros depend on them.
    rate_Hz : float, optional
        Sampling rate [Hz], for a table without times.

    Raises
    ------
    FlightDataError
        When the table has no five columns that can be the angles and voltages, or no times and no rate.
    """
    proposed, longest_parts = propose([table], rig, rate_Hz)
    return check_by_simulation(proposed, longest_parts, rig)[0]


def propose(
    tables: Sequence[Table], rig: Rig, rate_Hz: float | None = None, known: KnownEntries = NOTHING_KNOWN
) -> tuple[Guess, list[Table]]:
    """Propose one profile for the files of one rig, without simulating it. Returns `proposed`,
    `longest_parts`.

    The evidence of all files is added up. Names and the rig's deviation from its rig file count once,
    because all files share them.
    """
    reference = reference_of(rig)
    # Which column is which: by names, and by how well each assignment explains the motion.
    files = [prepare_file(known.with_units(table.aligned()), reference, rate_Hz) for table in tables]
    source = files[0].table.source
    clock, clock_ambiguities = _common_clock(files)
    columns, dropped = common_candidates(files, known.columns)
    if len(columns) < len(AXES) + 2:
        raise too_few_columns(source, columns, dropped)
    ranked, motions = rank(files, columns, reference, known)
    assignment = ranked[0]
    ambiguities, evidence = assignment_ambiguities(ranked)
    ambiguities += clock_ambiguities
    # Units: those with which the gains of the motion are most like the rig's.
    ranked_scales = pooled_scales(motions, reference)
    scale = ranked_scales[0]
    ambiguities += unit_ambiguities(ranked_scales, motions[0], reference, rig)
    limits = supply_limits(scale, motions, reference)
    # Signs: the axes have to accelerate in the direction of their causes.
    flights = _FlightsInUnits(files, assignment, scale, reference, limits)
    regressions = flights.regressions()
    if not names_state_voltages(assignment) and not known.knows_voltages:
        check_voltages(source, regressions, assignment)
        ambiguities += voltage_ambiguities(regressions, assignment, columns, dropped)
    signs = fewest_sign_changes(regressions, flights.feedback(), known)
    torque_nats = flights.torque_nats(signs)
    mirrored = prefers_mirror(signs, torque_nats) if known.mirrored is None else known.mirrored
    ambiguities += sign_ambiguities(regressions, signs, assignment, torque_nats, mirrored, rig)
    # Zero of the elevation, from the rest on the table, and delays between columns.
    offset_deg, zero_ambiguities = elevation_zero(flights.rest(signs), reference)
    timing_ambiguities, lag_sentence = lag_ambiguities(regressions)
    ambiguities += zero_ambiguities + timing_ambiguities
    profile = known.applied(
        Profile(
            _angle_entries(assignment, scale, signs, reference, offset_deg),
            _voltage_entries(assignment, scale, signs, reference),
            "" if rate_Hz else clock.column,
            clock.unit,
            rate_Hz or 0.0,
            about=f"guessed from {Path(source).name}",
            mirrored=mirrored,
        )
    )
    if dropped:
        evidence.append("left out: " + ", ".join(f"{name} ({reason})" for name, reason in dropped.items()))
    evidence += [_regression_sentence(axis, regressions[axis]) for axis in AXES]
    evidence += [lag_sentence, _hover_sentence(motions[0], scale, reference)]
    longest_parts = [file.table for file in files]
    # Programs log commands that the motors cannot follow: voltages above the supply were limited to it.
    if profile.clip_V is None:
        profile, limit_ambiguities = limited(longest_parts, profile, reference, flights.one_way_nats)
        ambiguities += limit_ambiguities
    ambiguities = [ambiguity for ambiguity in ambiguities if not known.states(ambiguity)]
    proposed = Guess(profile, tuple(ambiguities), tuple(evidence), log_likelihood=assignment.log_likelihood)
    return proposed, longest_parts


@dataclass(frozen=True)
class _FlightsInUnits:
    """Files whose columns have been assigned and whose units are chosen."""

    files: Sequence[PreparedFile]  # The files
    assignment: ColumnAssignment  # Column of each angle and voltage
    scale: Scale  # Units of the columns
    reference: Reference  # Gains, hover voltage and encoders of the rig file
    limits: tuple[float, float]  # Smallest and largest voltage of a motor, in the unit of the columns

    @property
    def rad(self) -> dict[str, float]:
        """Radians per unit of each angle's column, by axis."""
        return {axis: rad_of(self.scale.angles[axis], axis, self.reference) for axis in AXES}

    @property
    def bias(self) -> float:
        """Bias that the logged sum of the voltages lacks, in the unit of the columns."""
        if not self.scale.bias_removed:
            return 0.0
        return self.reference.hover_V / self.scale.volts(self.reference)

    def regressions(self) -> dict[str, RegressionFit]:
        """Regression of each axis' acceleration on its cause, over all files, by axis."""
        by_file = [
            axis_regressions(file.signals, self.assignment, self.reference, self.rad, self.bias, self.limits)
            for file in self.files
        ]
        return pooled_fits(by_file)

    def feedback(self) -> float:
        """Add up the signs of elevation's feedback over the files: each counts -1, 0 or 1; see
        `feedback_sign`.
        """
        total = 0.0
        for file in self.files:
            voltage_sum, _ = sum_and_difference(file.signals, self.assignment, self.bias, self.limits)
            elevation = file.signals.filtered[self.assignment.elevation]
            total += feedback_sign(
                filtered_signal(voltage_sum).value, elevation, file.signals.counts_per_turn
            )
        return total

    def torque_nats(self, signs: SignChanges) -> float:
        """Log-likelihood ratio of the `signs` against their mirror image, by the constant torque of travel
        [nats]; mean of all files.
        """
        by_file = [
            travel_torque_nats(file.signals, self.assignment, self.reference, self.rad, signs.travel)
            for file in self.files
        ]
        return float(np.mean(by_file))

    def one_way_nats(self) -> float:
        """Log-likelihood ratio of motors that do not reverse against motors within the limits [nats]."""

        def regress(limits: tuple[float, float]) -> Mapping[str, RegressionFit]:
            """Regressions of the axes with other limits."""
            return replace(self, limits=limits).regressions()

        return one_way_nats(regress, self.limits)

    def rest(self, signs: SignChanges) -> RestElevation:
        """Elevation at rest, of the first file that begins at rest at its lowest point; of the first file if
        no file does.
        """
        deg_per_unit = float(np.degrees(signs.elevation * self.rad["elevation"]))
        rests = [rest_elevation(file.signals, self.assignment.elevation, deg_per_unit) for file in self.files]
        return next((rest for rest in rests if rest.deg is not None and rest.begins_lowest), rests[0])


def _common_clock(files: Sequence[PreparedFile]) -> tuple[Clock, list[Ambiguity]]:
    """Find the time column that all files share. Returns `clock`, `ambiguities`."""
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


def check_by_simulation(proposed: Guess, tables: Sequence[Table], rig: Rig) -> list[Guess]:
    """Check the signs of a guess by simulation of the baseline model of a `rig`."""
    longest = [max(flights_of(table, proposed.profile), key=len) for table in tables]
    choices = [try_sign_choices(flight, rig) for flight in longest]
    simulated = [trials for trials in choices if trials]
    if not simulated:
        ambiguity = Ambiguity(
            "the signs",
            "as proposed",
            "any other signs",
            "the flight is too short in the air to simulate the model",
        )
        return [proposed.with_ambiguity(ambiguity) for _ in tables]
    log_ratios = np.mean(
        [[math.log(choice.error_ratio) for choice in trials] for trials in simulated], axis=0
    )
    second = int(np.argmin(log_ratios[1:])) + 1
    name, ratio = simulated[0][second].name, math.exp(float(log_ratios[second]))
    if ratio < thresholds.AMBIGUOUS_ERROR_RATIO:
        proposed = proposed.with_ambiguity(
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
    proposed = replace(proposed, evidence=(*proposed.evidence, evidence))
    return [replace(proposed, sign_choices=trials) for trials in choices]


def fewest_sign_changes(
    regressions: Mapping[str, RegressionFit], feedback: float, known: KnownEntries
) -> SignChanges:
    """Find the fewest changes of sign after which all axes follow their causes, and which agree with
    `known`.
    """
    elevation = 1.0 if regressions["elevation"].gain >= 0.0 else -1.0
    if feedback and regressions["elevation"].log_likelihood_ratio < thresholds.DECISIVE_NATS:
        # A loop that flies is stable: the sum is minus a gain times the rate.
        elevation = -float(np.sign(feedback))
    # Measured signs: does pitch accelerate with the voltage difference, and travel with pitch?
    pitch_gain_sign = 1.0 if regressions["pitch"].gain >= 0.0 else -1.0
    travel_gain_sign = 1.0 if regressions["travel"].gain >= 0.0 else -1.0
    # Each sign of pitch can be completed by signs of travel and motors; the two choices are mirror images.
    if known.sign("pitch"):
        pitch = known.sign("pitch")
    elif known.sign("travel"):
        pitch = travel_gain_sign * known.sign("travel")
    elif known.knows_motors:
        pitch = pitch_gain_sign
    elif pitch_gain_sign < 0.0 and travel_gain_sign < 0.0:
        # One change, of pitch, corrects both.
        pitch = -1.0
    else:
        pitch = 1.0
    return SignChanges(
        elevation,
        pitch,
        travel=travel_gain_sign * pitch,
        motors_swapped=pitch_gain_sign * pitch < 0.0,
    )


def _regression_sentence(axis: str, regression: RegressionFit) -> str:
    """Describe how well the cause of an axis explains its acceleration."""
    cause = {"elevation": "the sum of the voltages", "pitch": "their difference", "travel": "pitch"}[axis]
    direction = "with" if regression.gain >= 0.0 else "against"
    return f"{axis} accelerates {direction} {cause}: {regression.log_likelihood_ratio:.0f} nats"


def _hover_sentence(motion: MeasuredMotion, scale: Scale, reference: Reference) -> str:
    """Compare the mean sum of the voltages with that of hover in the rig file."""
    hover_V = abs(motion.mean_sum) * scale.volts(reference)
    return f"hover: the voltages add up to {hover_V:.2f} V, and to {reference.hover_V:.2f} V in the rig file"


def _angle_entries(
    assignment: ColumnAssignment, scale: Scale, signs: SignChanges, reference: Reference, offset_deg: float
) -> dict[str, Angle]:
    """Make the entries of the profile for the angles, by axis; `offset_deg` is added to the elevation."""
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


def _voltage_entries(
    assignment: ColumnAssignment, scale: Scale, signs: SignChanges, reference: Reference
) -> dict[str, Voltage]:
    """Make the entries of the profile for the voltages: sum and difference, or front and back."""
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
