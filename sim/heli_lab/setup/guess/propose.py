"""Propose a profile for logs of one rig: names decide which column is which, and physics confirms it."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
from heli_host.data.tables import Angle, Profile, Table, Voltage, flights_of, profile_text
from heli_host.data.tables.convert import unknown_column
from heli_host.data.tables.table import COUNT, SHARED_TIME, SHARES, TIME_UNITS, split_unit
from heli_host.errors import FlightDataError, HeliError
from heli_sim.rig import Rig, load_rig, rig_names

from heli_lab.setup.guess.columns import (
    PreparedFile,
    check_third_angle,
    check_voltages,
    column_ambiguities,
    column_options,
    equal_voltages,
    prepare_file,
    ranked_assignments,
    with_directions,
)
from heli_lab.setup.guess.motion import (
    Assignment,
    Reference,
    RegressionFit,
    VoltageLimits,
    axis_regressions,
    feedback_sign,
    lag_ambiguities,
    lag_sentence,
    pooled_fits,
    rate_nats,
    reference_of,
    steady_pitch_deg,
    sum_and_difference,
)
from heli_lab.setup.guess.names import AXES, PAIR, SUMS, meaning_of
from heli_lab.setup.guess.parts import part_ambiguities
from heli_lab.setup.guess.result import DECISIVE_NATS, NOTHING_KNOWN, Ambiguity, Guess, KnownEntries
from heli_lab.setup.guess.signals import MIN_FLIGHT_S, NO_RATE, Clock, filtered_signal
from heli_lab.setup.guess.signs import (
    SignChanges,
    fewest_sign_changes,
    prefers_mirror,
    sign_ambiguities,
    travel_torque_nats,
    try_sign_choices,
)
from heli_lab.setup.guess.units import (
    MeasuredMotion,
    RestElevation,
    Scale,
    choose_scale,
    elevation_zero,
    limited,
    measured_motion,
    one_way_nats,
    rest_elevation,
    scales,
    supply_limits,
    unknown_unit_ambiguities,
    with_logged_supply,
)

_CANDIDATE_MARGIN_NATS: Final = 25.0
"""Assignments of columns within this margin of the most likely one are compared by their units, too [nats].
An assignment without plausible units loses about this much. A higher value takes longer, a lower one neglects
the units."""
_UNCERTAIN_TIME_S: Final = 0.02
"""Error of times above which they are in doubt [s]. Rotors lag by 0.05 s and more."""
_MAX_TRIM_DEG: Final = 15.0
"""Median pitch of a flight above which its zero is in doubt [deg]. Constant torques of rigs need up to 8."""
_PITCH_TOLERANCE_DEG: Final = 3.0
"""Error of the pitch zero from which on it is in doubt [deg]. Simulated flights of half a minute show the
zero within 0.5 deg; rig files state it within 3 deg."""
_KNOWN_BALANCE_DEG: Final = 1.5
"""Standard deviation of the pitch that equal voltages hold, up to which this pitch shows the zero [deg].
Bodies with a pendulum give 0.1 to 0.6, bodies without give 3 and more."""
_MAX_CANDIDATES: Final = 12
"""Largest number of assignments whose units are compared."""
_AMBIGUOUS_ERROR_RATIO: Final = 1.15
"""Product of the axes' errors for another choice of signs, over that for the profile, below which the signs
are ambiguous. Wrong choices have 1.3 and more on measured flights. A lower value trusts chance."""


class ProposedGuess(NamedTuple):
    """A guess that has not been simulated yet."""

    guess: Guess
    longest_parts: list[Table]  # Longest part of each file in which times rise and no angle jumps


@dataclass(frozen=True)
class RigMatch:
    """Guesses of several files of one rig, with the rig that fits them.

    Parameters
    ----------
    rig : Rig
        The rig file that units and zeros come from.
    guesses : tuple of Guess
        One per file, in the order of the files; all have the same profile.
    """

    rig: Rig
    guesses: tuple[Guess, ...]


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
    return check_by_simulation(propose([table], rig, rate_Hz), rig)[0]


def _refuse_unknown_columns(tables: Sequence[Table], known: KnownEntries) -> None:
    """Refuse known entries with a column that none of the files has."""
    columns = [name for table in tables for name in (*table.columns, *table.unread)]
    stated = list(known.columns)
    if "column" in known.entries.get("time", {}):
        stated.append(str(known.entries["time"]["column"]))
    for name in stated:
        if name not in columns:
            raise unknown_column(tables[0].source, name, columns)


def guess_by_rigs(
    tables: Sequence[Table],
    rig: Rig | None = None,
    rate_Hz: float | None = None,
    known: KnownEntries = NOTHING_KNOWN,
    progress: Callable[[float], None] = lambda share: None,
) -> RigMatch:
    """Guess the profile of files of one rig, with a given rig file or with the shipped one that fits best.

    The guess reports which rig file it used. It is ambiguous if another rig file fits much better than the
    given one, or if two shipped ones fit about equally well and give different profiles.

    Parameters
    ----------
    tables : sequence of Table
        Logs of one rig, from one program.
    rig : Rig, optional
        Rig file to use.
    rate_Hz : float, optional
        Sampling rate [Hz], for tables without times.
    known : KnownEntries
        Entries of the profile that the user knows.
    progress : callable
        Called with the completed share of the work, 0 to 1.

    Raises
    ------
    FlightDataError
        When a table cannot be interpreted with any rig.
    """
    _refuse_unknown_columns(tables, known)
    rigs = {name: load_rig(name) for name in rig_names() if rig is None or name != rig.name}
    if rig is not None:
        rigs[rig.name] = rig
    # One step of work per rig, and one for the simulations.
    work_steps = len(rigs) + 1
    proposals: dict[str, ProposedGuess] = {}
    refusals: dict[str, HeliError] = {}
    for number, (name, candidate) in enumerate(rigs.items()):
        progress(number / work_steps)
        try:
            proposals[name] = propose(tables, candidate, rate_Hz, known)
        except HeliError as error:
            refusals[name] = error
    if not proposals or (rig is not None and rig.name not in proposals):
        raise refusals[rig.name if rig is not None else next(iter(refusals))]
    guess_of_rig = {name: proposal.guess for name, proposal in proposals.items()}
    best = max(guess_of_rig, key=lambda name: guess_of_rig[name].log_likelihood)
    chosen = rig.name if rig is not None else best
    profile = guess_of_rig[chosen].profile
    progress(1.0 - 1.0 / work_steps)
    guesses = check_by_simulation(proposals[chosen], rigs[chosen])
    evidence, ambiguities = _compare_with_second(guess_of_rig, chosen, is_given=rig is not None)
    if rig is None:
        ambiguities += _unknown_rig(profile, chosen, known)
    ambiguities += part_ambiguities(tables, profile, rigs[chosen], is_given=rig is not None)
    guesses = [
        replace(each, evidence=(*evidence, *each.evidence), ambiguities=(*ambiguities, *each.ambiguities))
        for each in guesses
    ]
    return RigMatch(rigs[chosen], tuple(guesses))


def _compare_with_second(
    guess_of_rig: Mapping[str, Guess], chosen: str, *, is_given: bool
) -> tuple[list[str], list[Ambiguity]]:
    """Compare the chosen rig file with the best of all others; return evidence and ambiguities."""
    others = [name for name in guess_of_rig if name != chosen]
    # Rigs that give the same profile are not an ambiguity, but the better fit is reported.
    profile = profile_text(guess_of_rig[chosen].profile)
    differing = [name for name in others if profile_text(guess_of_rig[name].profile) != profile]
    second = max(differing or others, key=lambda name: guess_of_rig[name].log_likelihood, default=None)
    if second is None:
        return [], []
    lead_nats = guess_of_rig[chosen].log_likelihood - guess_of_rig[second].log_likelihood
    comparison = f"{abs(lead_nats):.0f} nats {'worse' if lead_nats >= 0.0 else 'better'}"
    evidence = [f"rig: compared with {chosen}; {second} fits {comparison}"]
    # A given rig is used unless another one fits clearly better; an automatic choice must win clearly.
    required_nats = -DECISIVE_NATS if is_given else DECISIVE_NATS
    if not differing or lead_nats >= required_nats:
        return evidence, []
    reason = f"it fits {comparison}, with other units or columns; if it is your rig, give --rig {second}"
    return evidence, [Ambiguity("the rig", chosen, second, reason)]


def _unknown_rig(profile: Profile, rig_name: str, known: KnownEntries) -> list[Ambiguity]:
    """Report counts per turn and a zero of elevation from a rig file that the user has not named."""
    counts = [
        f"{axis} {angle.counts:g}"
        for axis, angle in profile.angles.items()
        if angle.unit == COUNT and "counts" not in known.entries.get(axis, {})
    ]
    reason = (
        f"these are those of rig {rig_name}, and the motion shows them only roughly; give your rig with --rig"
    )
    ambiguities = (
        [Ambiguity("the scale of the encoders", ", ".join(counts), "others", reason)] if counts else []
    )
    added_deg = profile.angles["elevation"].offset_deg
    if added_deg and "offset_deg" not in known.entries.get("elevation", {}):
        ambiguities.append(
            Ambiguity(
                "the elevation's zero",
                f"{added_deg:g} deg added, so that the arm rests at the table of rig {rig_name}",
                "the angle of another table",
                "the log is 0 at rest, and does not show how deep the table is; give your rig with --rig",
            )
        )
    return ambiguities


def propose(
    tables: Sequence[Table], rig: Rig, rate_Hz: float | None = None, known: KnownEntries = NOTHING_KNOWN
) -> ProposedGuess:
    """Propose one profile for the files of one rig, without simulating it; `rate_Hz` replaces their times."""
    reference = reference_of(rig)
    signed = [with_directions(known.with_units(table.aligned(_named_angles(table)))) for table in tables]
    files = [prepare_file(table, reference, rate_Hz, known) for table, _ in signed]
    direction_columns = {voltage: column for _, used in signed for voltage, column in used.items()}
    first_table, _ = signed[0]
    source = files[0].table.source
    clock, ambiguities = _common_clock(files)
    # Which column is which: by names, and otherwise by how well each assignment explains the motion.
    options = column_options(files, known)
    ranked = ranked_assignments(files, options, reference)
    if not ranked:
        raise _with_uncertain_time(options.too_few(source), source, clock)
    ranked, motion = _ranked_by_units_too(files, ranked, reference)
    assignment = ranked[0]
    doubtful_columns, columns_sentence = column_ambiguities(ranked, options, files, reference)
    # Units: those that the file states, and otherwise those with gains like the rig's.
    reference, scale, unit_ambiguities = _chosen_units(files, motion, reference, rig)
    flights = _FlightsInUnits(files, assignment, scale, reference, supply_limits(scale, motion, reference))
    regressions = flights.regressions()
    ambiguities += doubtful_columns + unit_ambiguities + unknown_unit_ambiguities(assignment, scale)
    if clock.sure and not _states_time_unit(first_table, clock, files[0]) and _fits_nothing(regressions):
        clock = replace(clock, sure=False, alternative="another unit, which the file does not state")
        ambiguities.append(
            Ambiguity("the time", f"{clock.column} in {clock.unit}", clock.alternative, NO_RATE)
        )
    try:
        check_third_angle(source, regressions, assignment, options, files, reference)
        ambiguities += check_voltages(source, regressions, assignment, options, files)
    except FlightDataError as error:
        raise _with_uncertain_time(error, source, clock) from error
    # Signs: the axes have to accelerate in the direction of their causes.
    signs = fewest_sign_changes(regressions, flights.feedback(), known)
    torque_nats = flights.torque_nats(signs)
    mirrored = prefers_mirror(signs, torque_nats) if known.mirrored is None else known.mirrored
    states_motors = options.stated.issuperset((SUMS[1],) if assignment.summed else PAIR)
    ambiguities += sign_ambiguities(
        regressions, signs, assignment, states_motors, mirrored, _torque_text(torque_nats, mirrored, rig)
    )
    ambiguities += flights.rates() + equal_voltages(assignment, files) + flights.inverted_shares(signs)
    # Zero of the elevation, from the rest on the table, and delays between columns.
    offset_deg, zero_ambiguities = elevation_zero(flights.rest(signs), reference)
    ambiguities += zero_ambiguities + lag_ambiguities(regressions)
    ambiguities += flights.pitch_zero(signs, regressions["pitch"].lag_s)
    ambiguities += [_moved_by_hand(file.by_hand_s) for file in files if file.by_hand_s][:1]
    profile = known.applied(
        Profile(
            _angle_entries(assignment, scale, signs, reference, offset_deg),
            _voltage_entries(assignment, scale, signs, reference, direction_columns),
            time="" if rate_Hz else clock.column,
            time_unit=clock.unit,
            rate_Hz=rate_Hz or 0.0,
            about=f"guessed from {Path(source).name}",
            mirrored=mirrored,
        )
    )
    longest_parts = [file.table for file in files]
    # Programs log commands that the motors cannot follow: voltages above the supply were limited to it.
    if profile.clip_V is None:
        profile, limit_ambiguities = limited(longest_parts, profile, reference, flights.one_way_nats)
        ambiguities += limit_ambiguities
    unknown = tuple(ambiguity for ambiguity in ambiguities if not known.states(ambiguity))
    evidence = [columns_sentence, *known.contradicted_headers(tables[0])]
    if options.left_out:
        evidence.append(options.left_out_text)
    evidence += [_regression_sentence(axis, regressions[axis]) for axis in AXES]
    evidence += [lag_sentence(regressions), _hover_sentence(motion, scale, reference)]
    proposed = Guess(profile, unknown, tuple(evidence), log_likelihood=assignment.log_likelihood)
    return ProposedGuess(proposed, longest_parts)


def _moved_by_hand(span_s: tuple[float, float]) -> Ambiguity:
    """Report a part of a file in which the arm moves while the motors are off."""
    begin_s, end_s = span_s
    span = f"{begin_s:.1f} to {end_s:.1f} s"
    return Ambiguity(
        "the rows with the motors off",
        "part of the flight",
        f"moved by hand from {span}",
        "the arm moves there, and no motor does; if by hand, leave this part out with leave_out_s",
    )


class _ChosenUnits(NamedTuple):
    """Units of the columns, and what is unsure about them."""

    reference: Reference  # The reference with the supply that the files log, if the voltages are shares of it
    scale: Scale
    ambiguities: list[Ambiguity]


def _chosen_units(
    files: Sequence[PreparedFile], motion: MeasuredMotion, reference: Reference, rig: Rig
) -> _ChosenUnits:
    """Choose the units with the rig file's supply, and once more if the files log another supply."""
    scale, ambiguities = choose_scale(motion, reference, rig)
    hover_V = abs(motion.mean_sum) * scale.volts(reference)
    logged_supply = with_logged_supply(reference, files, hover_V)
    # Only shares depend on the supply; without another supply in the files, `reference` itself is returned.
    if scale.voltage not in SHARES or logged_supply is reference:
        return _ChosenUnits(reference, scale, ambiguities)
    return _ChosenUnits(logged_supply, *choose_scale(motion, logged_supply, rig))


def _states_time_unit(table: Table, clock: Clock, file: PreparedFile) -> bool:
    """Whether the file states the unit of its times, or has none."""
    if not clock.column:
        return True
    # Times of a structure count as seconds, which a flight that would be too short contradicts.
    if clock.column == SHARED_TIME and float(np.ptp(file.signals.t_s)) < MIN_FLIGHT_S:
        return False
    return (table.columns[clock.column].unit or split_unit(clock.column)[1]) in TIME_UNITS


def _fits_nothing(regressions: Mapping[str, RegressionFit]) -> bool:
    """Whether neither elevation nor pitch follows the voltages, as in times of a wrong unit."""
    return all(regressions[axis].log_likelihood_ratio < DECISIVE_NATS for axis in ("elevation", "pitch"))


def _with_uncertain_time(error: FlightDataError, source: str, clock: Clock) -> FlightDataError:
    """Return the `error` of a table without a rig's motion; an uncertain time may be the reason."""
    if clock.sure:
        return error
    return FlightDataError(
        f"{source}: the time is uncertain ('{clock.column}' in {clock.unit}, or {clock.alternative}), and "
        f"with it {error.cause.removeprefix(f'{source}: ')}",
        f"{NO_RATE}; {error.remedy}",
    )


def _named_angles(table: Table) -> list[str]:
    """List the columns whose names state an angle: between their values lies a straight line."""
    return [name for name, column in table.columns.items() if meaning_of(name, column.unit).role in AXES]


def _common_clock(files: Sequence[PreparedFile]) -> tuple[Clock, list[Ambiguity]]:
    """Find the time column that all files share; report if it is not sure."""
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
        uncertain_s = max(file.uncertain_s for file in files)
        if uncertain_s < _UNCERTAIN_TIME_S:
            return clock, []
        return clock, [
            Ambiguity(
                "the time",
                f"{clock.column}, with rows spread evenly where it repeats a time",
                f"times up to {uncertain_s:.2f} s earlier or later",
                "the clock does not show where rows are missing, or how long it stood still; log a clock "
                "with more digits",
            )
        ]
    other = clock.alternative or "something else"
    return clock, [Ambiguity("the time", f"{clock.column} in {clock.unit}", other, NO_RATE)]


def _ranked_by_units_too(
    files: Sequence[PreparedFile], ranked: Sequence[Assignment], reference: Reference
) -> tuple[list[Assignment], MeasuredMotion]:
    """Rank the likeliest assignments by their best units too: wrong columns have implausible gains. Return
    them with the motion of the first.
    """
    close = [
        assignment
        for assignment in ranked[:_MAX_CANDIDATES]
        if ranked[0].log_likelihood - assignment.log_likelihood < _CANDIDATE_MARGIN_NATS
    ]
    motions = [measured_motion(files, assignment, reference) for assignment in close]
    units_nats = [scales(motion, reference)[0].log_likelihood for motion in motions]
    totals = [assignment.log_likelihood + nats for assignment, nats in zip(close, units_nats, strict=True)]
    order = sorted(range(len(close)), key=lambda i: -totals[i])
    rescored = [replace(close[i], log_likelihood=totals[i]) for i in order]
    # The others are too unlikely for their units to matter.
    others = [
        replace(assignment, log_likelihood=assignment.log_likelihood + units_nats[order[0]])
        for assignment in ranked[len(close) :]
    ]
    return rescored + others, motions[order[0]]


@dataclass(frozen=True)
class _FlightsInUnits:
    """Files whose columns have been assigned and whose units are chosen."""

    files: Sequence[PreparedFile]  # The files
    assignment: Assignment  # Column of each angle and voltage
    scale: Scale  # Units of the columns
    reference: Reference  # Gains, hover voltage and encoders of the rig file
    limits: VoltageLimits  # Smallest and largest voltage of a motor, in the unit of the columns

    @property
    def bias(self) -> float:
        """Bias that the logged sum of the voltages lacks, in the unit of the columns."""
        if not self.scale.bias_removed:
            return 0.0
        return self.reference.hover_V / self.scale.volts(self.reference)

    def regressions(self) -> dict[str, RegressionFit]:
        """Regression of each axis' acceleration on its cause, over all files, by axis."""
        rad = self.scale.rad(self.reference)
        by_file = [
            axis_regressions(file.signals, self.assignment, self.reference, rad, self.bias, self.limits)
            for file in self.files
        ]
        return pooled_fits(by_file)

    def rates(self) -> list[Ambiguity]:
        """Report each column that moves like the rate of its axis, although it counts as the angle."""
        by_file = [
            rate_nats(file.signals, self.assignment, self.reference, self.limits) for file in self.files
        ]
        nats = {axis: float(sum(each[axis] for each in by_file)) for axis in AXES}
        # The rate of pitch does not drive travel, so that nothing is known of travel.
        axes = [axis for axis in AXES if axis != "travel" or nats["pitch"] <= DECISIVE_NATS]
        return [
            Ambiguity(
                f"{axis}'s column",
                f"{self.assignment.columns[axis]}, as the angle",
                f"{self.assignment.columns[axis]} is the rate, and the angle is another column",
                f"the motion is {nats[axis]:.0f} nats for the rate; look up which column is the angle",
            )
            for axis in axes
            if nats[axis] > DECISIVE_NATS
        ]

    def inverted_shares(self, signs: SignChanges) -> list[Ambiguity]:
        """Report shares of the supply that may be largest with the motor off, as those of inverting drivers:
        then elevation rises against them.
        """
        if self.scale.voltage not in SHARES or signs.elevation > 0.0:
            return []  # volts are not inverted, or elevation rises with them
        for file in self.files:
            first, second = (file.table.columns[name].values for name in self.assignment.voltages)
            if file.begins and first[0] == 0.0 and second[0] == 0.0:
                # Before a flight the motors are off.
                return []
        return [
            Ambiguity(
                "elevation's sign",
                "the opposite of the log, because it rises against the voltages",
                f"as in the log, and {self.scale.voltage} is inverted",
                "0 may be full voltage; look up the value of a motor that is off",
            )
        ]

    def feedback(self) -> float:
        """Add up the signs of elevation's feedback over the files: each counts -1, 0 or 1; see
        `feedback_sign`.
        """
        total = 0.0
        for file in self.files:
            voltage_sum, _ = sum_and_difference(file.signals, self.assignment, self.bias, self.limits)
            elevation = file.signals.filtered[self.assignment.columns["elevation"]]
            total += feedback_sign(filtered_signal(voltage_sum).value, elevation, file.signals)
        return total

    def torque_nats(self, signs: SignChanges) -> float:
        """Mean evidence of the travel torque for the `signs` against their mirror image [nats]."""
        rad = self.scale.rad(self.reference)
        by_file = [
            travel_torque_nats(file.signals, self.assignment, self.reference, rad, signs.travel)
            for file in self.files
        ]
        return float(np.mean(by_file))

    def one_way_nats(self) -> float:
        """Log-likelihood ratio of motors that do not reverse against motors within the limits [nats]."""
        return one_way_nats(lambda limits: replace(self, limits=limits).regressions(), self.limits)

    def rest(self, signs: SignChanges) -> RestElevation:
        """Elevation at rest, of the first file that begins at rest at its lowest point; of the first file if
        no file does.
        """
        rad = self.scale.rad(self.reference)
        deg_per_unit = {axis: math.degrees(getattr(signs, axis) * rad[axis]) for axis in AXES}
        rests = [
            replace(rest, deg=rest.deg if file.begins else None)
            for file in self.files
            for rest in [rest_elevation(file.signals, self.assignment.columns, deg_per_unit)]
        ]
        return next((rest for rest in rests if rest.deg is not None and rest.begins_lowest), rests[0])

    def pitch_zero(self, signs: SignChanges, lag_s: float) -> list[Ambiguity]:
        """Report a pitch whose zero the motion contradicts; pitch follows the voltages after a lag, `lag_s`.

        Travel is steady at level pitch, except for the constant torque that the rig file states.
        """
        rad = self.scale.rad(self.reference)
        by_file = [steady_pitch_deg(file.signals, self.assignment, rad, lag_s) for file in self.files]
        # Means over the files: the pitch with steady travel, and the pitch that equal voltages hold.
        (level_deg, level_std_deg), (held_deg, held_std_deg) = np.mean(by_file, axis=0)
        level_deg, held_deg = float(signs.pitch * level_deg), float(signs.pitch * held_deg)
        expected_deg, torque_std_deg = self.reference.level_pitch_deg
        # Cables pull in either direction, and so does a mirror image.
        errors_deg = (level_deg - expected_deg, level_deg + expected_deg)
        tolerance_deg = math.hypot(_PITCH_TOLERANCE_DEG, torque_std_deg)
        error_deg = min(errors_deg, key=abs)
        if held_std_deg < _KNOWN_BALANCE_DEG:
            # The voltages show the zero, too: if they contradict travel, the torque differs, not the zero.
            tolerance_deg = self.reference.pitch_zero_deg
            level_std_deg = max(level_std_deg, held_std_deg)
            error_deg = min(errors_deg, key=lambda error_deg: abs(error_deg - held_deg))
            error_deg = min(error_deg, held_deg, key=abs) if error_deg * held_deg > 0.0 else 0.0
        if not abs(error_deg) > tolerance_deg + 2.0 * level_std_deg:
            return self._pitch_trim(signs)
        return [
            Ambiguity(
                "pitch's zero",
                f"0 as it is, with travel steady at {level_deg:.1f} deg of pitch",
                f"{-error_deg:.1f} deg to add",
                f"the rig file's torque makes it steady at {abs(expected_deg):.0f} deg at most, so it or the "
                "zero differs; measure the pitch with a level body",
            )
        ]

    def _pitch_trim(self, signs: SignChanges) -> list[Ambiguity]:
        """Report if the pitch in flight is farther from 0 than a trim against a constant torque can be."""
        deg_per_unit = math.degrees(signs.pitch * self.scale.rad(self.reference)["pitch"])
        column = self.assignment.columns["pitch"]
        medians_deg = [deg_per_unit * float(np.median(file.signals.raw[column])) for file in self.files]
        median_deg = float(np.median(medians_deg)) - 360.0 * round(float(np.median(medians_deg)) / 360.0)
        if abs(median_deg) < _MAX_TRIM_DEG:
            return []
        return [
            Ambiguity(
                "pitch's zero",
                f"0 as it is, with {median_deg:.0f} deg in flight",
                f"{-median_deg:.0f} deg to add",
                "an arm that pitches so far accelerates in travel; measure the pitch with a level body",
            )
        ]


def check_by_simulation(proposal: ProposedGuess, rig: Rig) -> list[Guess]:
    """Check the signs of a guess by simulation of the baseline model of a `rig`; return one guess per
    file.
    """
    proposed, tables = proposal
    longest = [max(flights_of(table, proposed.profile), key=len) for table in tables]
    choices_by_file = [try_sign_choices(flight, rig) for flight in longest]
    simulated = [choices for choices in choices_by_file if choices]
    if not simulated:
        ambiguity = Ambiguity(
            "the signs",
            "as proposed",
            "any other signs",
            "the flight is too short in the air to simulate the model",
        )
        return [proposed.with_ambiguity(ambiguity) for _ in tables]
    # Mean over the files, for each choice of signs.
    log_ratios = np.mean(
        [[math.log(choice.error_ratio) for choice in choices] for choices in simulated], axis=0
    )
    # All files have the same choices, the proposed one first.
    second = int(np.argmin(log_ratios[1:])) + 1
    name, ratio = simulated[0][second].name, math.exp(float(log_ratios[second]))
    if ratio < _AMBIGUOUS_ERROR_RATIO:
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
    return [replace(proposed, sign_choices=choices) for choices in choices_by_file]


def _torque_text(torque_nats: float, mirrored: bool, rig: Rig) -> str:
    """Describe the evidence of the travel torque for the chosen image; empty if the rig states no torque."""
    if not torque_nats:
        return ""
    nats = -torque_nats if mirrored else torque_nats
    return (
        f"; the constant travel torque of rig {rig.name} is {abs(nats):.1f} nats "
        f"{'for' if nats >= 0.0 else 'against'} the choice"
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
    assignment: Assignment, scale: Scale, signs: SignChanges, reference: Reference, offset_deg: float
) -> dict[str, Angle]:
    """Make the entries of the profile for the angles, by axis; `offset_deg` is added to the elevation."""
    return {
        axis: Angle(
            assignment.columns[axis],
            scale.angles[axis],
            reference.counts[axis],
            getattr(signs, axis),
            round(offset_deg, 3) if axis == "elevation" else 0.0,
        )
        for axis in AXES
    }


def _voltage_entries(
    assignment: Assignment,
    scale: Scale,
    signs: SignChanges,
    reference: Reference,
    direction_columns: Mapping[str, str],
) -> dict[str, Voltage]:
    """Make the entries of the profile for the voltages: sum and difference, or front and back.

    `direction_columns` has the column of the direction of each voltage that was logged without its sign.
    """
    first, second = (
        Voltage(
            column,
            scale.voltage,
            scale.full_scale,
            reference.supply_V,
            polarity,
            factor=scale.factor,
            supply_column=reference.supply_column,
            sign_column=direction_columns.get(column, ""),
        )
        for column, polarity in zip(assignment.voltages, assignment.polarity, strict=True)
    )
    if not assignment.summed:
        front, back = (second, first) if signs.motors_swapped else (first, second)
        return dict(zip(PAIR, (front, back), strict=True))
    if scale.bias_removed:
        first = replace(first, offset_V=round(reference.hover_V, 3))
    if signs.motors_swapped:
        second = replace(second, sign=-second.sign)
    return dict(zip(SUMS, (first, second), strict=True))
