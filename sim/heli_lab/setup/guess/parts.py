"""Doubts about parts of a file: a sign, a unit, an angle, a voltage or the clock that changes within it."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Final, NamedTuple

import numpy as np
from heli_host.data.arrays import Booleans, Floats
from heli_host.data.flight import Flight, check_flight
from heli_host.data.tables import Column, Conversion, Profile, Table, convert
from heli_host.data.tables.convert import times_of
from heli_host.data.tables.rows import runs_of
from heli_host.data.tables.table import COUNT
from heli_host.errors import FlightDataError
from heli_sim.rig import Rig

from heli_lab.setup.guess.motion import Assignment, Reference, RegressionFit, axis_regressions, reference_of
from heli_lab.setup.guess.names import AXES, PAIR
from heli_lab.setup.guess.result import DECISIVE_NATS, Ambiguity
from heli_lab.setup.guess.signals import EDGE_S, column_signals, delay, quantisation_step
from heli_lab.setup.guess.signs import confirmed_by_simulation, sign_suspects

_COLUMNS: Final = ("elevation_rad", "pitch_rad", "travel_rad", "front_V", "back_V")
_STANDING_SHARE: Final = 0.2
"""Share of the rows that stand still from which on they are in doubt: links seldom fail for so long."""
_PART_S: Final = 12.0
"""Length of the parts in which signs and units are compared [s]: in most of them, each axis moves enough."""
_SIGN_NATS: Final = 10.0
"""Evidence from which on an axis moves against its cause in a part [nats]. Among dozens of parts, some give
more than `DECISIVE_NATS` by chance."""
_UNIT_RATIO: Final = 6.0
"""Ratio of the gains of two parts from which on a unit changes between them. Parts of measured and simulated
flights differ by up to 3, degrees and radians by 57."""
_STEPS_RATIO: Final = 20.0
"""The same ratio of the steps of an encoder. Rows that are filled in divide a step by up to 6."""
_NEAR_S: Final = 0.3
"""Time before and after a part in which a voltage still changes [s]."""
_HELD_S: Final = 0.6
_HELD_INTERVALS: Final = 5.0
_MAX_INTERVAL_S: Final = 0.1
"""Shortest time for which a voltage is held by a failed link [s], also as a multiple of the usual interval
between its changes. A voltage that changes less often is a signal of steps."""
_MIN_INTERVALS: Final = 10
"""Smallest number of these intervals. A voltage with fewer is that of steps."""
_LIMIT_SHARE: Final = 0.3
"""Share of this time from which on a voltage is held at other times, too, so that it is a limit."""
_VOLTAGE_JUMP: Final = 2.0
_LIMIT_JUMP: Final = 0.5
"""Steps to and from a voltage that is also a limit, as a multiple of large steps near them, and as a share of
the distance of the limit from the usual voltage. Amplifiers reach their limits within several rows."""
_CHANGING_SHARE: Final = 0.5
"""Smallest number of changes beside such a part, as a share of the usual one."""
_ERROR_RATIO: Final = 2.0
"""Squared error of the model of pitch with a voltage at its limit, over that with a straight line in its
place, from which on the motor did not get this voltage. Set by judgement."""
_ALOFT_DEG: Final = 2.0
"""Height above the lowest elevation from which on the arm does not rest on its table [deg]."""
_FLAT_S: Final = 0.3
"""Shortest time at the highest or the lowest angle [s] that may be a limit of the sensor."""
_FLAT_STEPS: Final = 4.0
"""Motion just before and after this time, in steps of the encoder. An arm that turns round slows down first:
it moves by 1.3 steps."""
_FINEST_STEP_deg: Final = 0.02
"""Smallest step of an encoder for this comparison [deg]; angles that are not quantised have the step 0."""
_JUMP_ACCELERATIONS: Final = 5.0
_JUMP_DEG: Final = 1.5
"""Smallest jump of an angle, as a multiple of the 99 % quantile of its second differences, and in degrees."""
_JUMP_ROWS: Final = 5
_STAYING_SHARE: Final = 0.6
"""Rows before and after a jump whose medians are compared, and the share of the jump by which they differ at
least: after a single wrong value, the angle returns."""
_BLOCK_ROWS: Final = 100
_STEP_RATIO: Final = 1.5
_EVEN_RATIO: Final = 1.3
_CHANGED_S: Final = 2.0
"""Rows of a block, ratio of its typical step of time to that of the file, largest ratio of its steps, and
shortest time of such blocks, from which on the clock changes its rate. Rows that are lost at random make
uneven blocks."""
_DECODINGS: Final = (0.25, 0.5, 2.0, 4.0)
_COUNTS_TOLERANCE: Final = 0.01
"""Ratios between the edges of an encoder that programs count, and their tolerance."""


def part_ambiguities(
    tables: Sequence[Table], profile: Profile, rig: Rig, *, is_given: bool
) -> list[Ambiguity]:
    """List what changes within the files, although a profile has one entry for all of their parts.

    `is_given` states that the user named the rig, so that its encoders count.
    """
    reference = reference_of(rig)
    ambiguities: list[Ambiguity] = []
    flights: list[Flight] = []
    for table in tables:
        try:
            conversion = convert(table, profile)
        except FlightDataError:
            # The conversion itself states the reason.
            continue
        flights += conversion.flights
        ambiguities += _standing_rows(conversion)
        rows = table.aligned([angle.column for angle in profile.angles.values()])
        ambiguities += _changed_rate(rows, profile) + _decodings(rows, profile, rig, is_given=is_given)
    ambiguities += _changed_motion(flights, reference, rig)
    for flight in flights:
        ambiguities += _impossible_values(flight)
        ambiguities += _jumps(flight) + _flat_tops(flight) + _held_voltages(flight, reference)
    # The first ambiguity of each subject.
    return list({ambiguity.subject: ambiguity for ambiguity in reversed(ambiguities)}.values())[::-1]


def _standing_rows(conversion: Conversion) -> list[Ambiguity]:
    """Report a large part of a file that was left out because angles stand still: an arm with much friction
    does so, too.
    """
    standing = sum(change.rows for change in conversion.changes if change.is_standing)
    if standing <= _STANDING_SHARE * conversion.file_rows:
        return []
    return [
        Ambiguity(
            "the rows that stand still",
            f"left out, {100.0 * standing / conversion.file_rows:.0f} % of the file",
            "part of the flight",
            "a link that failed repeats its angles, but an arm with much friction does so, too; look at the "
            "figure, and import the part that is a flight",
        )
    ]


def _impossible_values(flight: Flight) -> list[Ambiguity]:
    """Report a flight that nobody can write, because a part of it has values that no rig reaches."""
    try:
        check_flight(flight, "")
    except FlightDataError as error:
        reason = error.cause.removeprefix(": ")
        axes = [axis for axis in AXES if reason.startswith(axis)]
        subject = f"{axes[0]}'s unit" if axes else "the time" if reason.startswith("t_s") else "the units"
        reason = f"no flight can be written, because {reason}; correct its column, unit or zero"
        return [
            Ambiguity(subject, "as proposed", "another unit, or other values in a part of the file", reason)
        ]
    return []


def _changed_rate(table: Table, profile: Profile) -> list[Ambiguity]:
    """Report a clock whose step changes for good, as if it changed its rate."""
    if not profile.time:
        return []  # the user has stated a constant rate
    t_s = times_of(table, profile)
    steps_s = np.diff(t_s)
    # Shape (blocks, rows of a block); the rows that fill no block are left out.
    blocks = steps_s[: steps_s.size // _BLOCK_ROWS * _BLOCK_ROWS].reshape(-1, _BLOCK_ROWS)
    if len(blocks) < 2 or not (steps_s > 0.0).all():
        return []  # nothing to compare, or ratios of steps have no meaning
    # Short, typical and long steps of each block.
    low_s, median_s, high_s = np.quantile(blocks, (0.1, 0.5, 0.9), axis=1)
    typical_s = float(np.median(median_s))
    has_other_step = np.maximum(median_s, typical_s) > _STEP_RATIO * np.minimum(median_s, typical_s)
    is_even = high_s < _EVEN_RATIO * low_s
    for start, stop in runs_of(has_other_step & is_even):
        first, last = start * _BLOCK_ROWS, stop * _BLOCK_ROWS
        if t_s[last] - t_s[first] < _CHANGED_S:
            continue  # not for good
        step_s = float(np.median(median_s[start:stop]))
        return [
            Ambiguity(
                "the rate of the clock",
                f"'{profile.time}' as it is, with steps of {step_s:.4g} s from {t_s[first]:.1f} to "
                f"{t_s[last]:.1f} s, and of {typical_s:.4g} s elsewhere",
                "the same step everywhere",
                "either rows are missing there, or the clock runs at another rate; look up the step of your "
                "logger, and add --rate if it never changes",
            )
        ]
    return []


def _parts_of(flight: Flight) -> Iterator[Flight]:
    """Divide a flight into parts of equal length, each of which shares its halves with its neighbours."""
    halves = max(2, 2 * int(flight.duration_s / _PART_S))
    edges = np.linspace(0, len(flight), halves + 1).astype(int).tolist()
    for start, stop in zip(edges[:-2], edges[2:], strict=True):
        yield flight.between(float(flight.t_s[start]), float(flight.t_s[stop - 1]) + 0.5 * flight.step_s)


def _regressions(part: Flight, reference: Reference) -> dict[str, RegressionFit]:
    """Regress the acceleration of each axis on its cause; empty if a column is constant."""
    table = Table("flight", {name: Column(getattr(part, name)) for name in _COLUMNS})
    signals = column_signals(table, part.t_s, list(_COLUMNS))
    # A part of a few rows has no signals.
    if len(signals.raw) < len(_COLUMNS) or not signals.inner.any():
        return {}
    if any(np.ptp(signals.raw[name]) == 0.0 for name in _COLUMNS):
        return {}
    assignment = Assignment(dict(zip((*AXES, *PAIR), _COLUMNS, strict=True)))
    return axis_regressions(signals, assignment, reference, dict.fromkeys(AXES, 1.0))


def _changed_motion(flights: Sequence[Flight], reference: Reference, rig: Rig) -> list[Ambiguity]:
    """Report parts in which an axis moves against its cause, or many times as far as in the others."""
    parts = [part for flight in flights for part in _parts_of(flight) if part.duration_s > 0.5 * _PART_S]
    if len(parts) < 2:
        return []  # nothing to compare with
    fitted = [_FittedPart(part, _regressions(part, reference)) for part in parts]
    result = _changed_signs(fitted, rig)
    for axis in AXES:
        steps = [(part, step) for part in parts if (step := quantisation_step(getattr(part, f"{axis}_rad")))]
        gains = [
            (part, abs(fits[axis].gain))
            for part, fits in fitted
            if fits and fits[axis].log_likelihood_ratio > DECISIVE_NATS
        ]
        by_steps = _changed_unit(axis, steps, _STEPS_RATIO, "moves in steps that are {} as large")
        result += by_steps or _changed_unit(axis, gains, _UNIT_RATIO, "responds {} as strongly")
    return result


class _FittedPart(NamedTuple):
    """A part of a flight, and the regressions of its axes; empty if a column is constant."""

    part: Flight
    fits: dict[str, RegressionFit]


def _changed_signs(fitted: Sequence[_FittedPart], rig: Rig) -> list[Ambiguity]:
    """Report the parts in which an axis moves against its cause, if it does not in all of them."""
    suspects_by_part = [(part, sign_suspects(fits, _SIGN_NATS)) for part, fits in fitted if fits]
    opposite = [(part, suspects) for part, suspects in suspects_by_part if suspects]
    if len(opposite) == 1:
        # Feedback without excitation shows the opposite sign now and then.
        ((part, suspects),) = opposite
        confirmed = confirmed_by_simulation(suspects, part, rig)
        opposite = [(part, confirmed)] if confirmed else []
    if not opposite or len(opposite) == len(fitted):
        return []  # the parts agree; signs of the whole file are checked elsewhere
    part, (suspect, *_) = opposite[0]
    return [
        Ambiguity(
            "the signs in parts of the file",
            "as proposed",
            f"{' and '.join(suspect.inverted_axes)} with the opposite sign from "
            f"{_span_text(part)}{_more_text(len(opposite) - 1)}",
            f"there, {suspect.description}; look up what changed within the file, and leave the part out "
            "with leave_out_s",
        )
    ]


def _changed_unit(
    axis: str, sizes: Sequence[tuple[Flight, float]], ratio: float, difference: str
) -> list[Ambiguity]:
    """Report a unit that changes if the `sizes` of two parts differ by more than this `ratio`.

    `difference` states it, with ``{}`` for how many times the size is.
    """
    if not sizes:
        return []
    part, smallest = min(sizes, key=lambda pair: pair[1])
    other, largest = max(sizes, key=lambda pair: pair[1])
    if largest <= ratio * smallest:
        return []
    times = f"{largest / smallest:.0f} times"
    return [
        Ambiguity(
            f"{axis}'s unit in parts of the file",
            "the same in the whole file",
            f"another one from {_span_text(part)} than from {_span_text(other)}",
            f"in the latter, {axis} {difference.format(times)}; look up what changed within the file, and "
            "leave one part out with leave_out_s",
        )
    ]


def _span_text(part: Flight) -> str:
    return f"{part.t_s[0]:.1f} to {part.t_s[-1]:.1f} s"


def _more_text(count: int) -> str:
    return f" and in {count} other parts" if count else ""


def _jumps(flight: Flight) -> list[Ambiguity]:
    """Report angles that jump from one row to the next, and stay there: an encoder has lost counts."""
    result = []
    for axis in AXES:
        angle_deg = np.degrees(getattr(flight, f"{axis}_rad"))
        # A jump gives two large second differences of opposite sign, one at either side.
        bends_deg = np.diff(angle_deg, 2)
        sizes_deg = np.abs(bends_deg)
        limit_deg = max(_JUMP_DEG, _JUMP_ACCELERATIONS * float(np.quantile(sizes_deg, 0.99)))
        is_large = np.minimum(sizes_deg[:-1], sizes_deg[1:]) > limit_deg
        is_jump = is_large & (bends_deg[:-1] * bends_deg[1:] < 0.0)
        for row in (np.flatnonzero(is_jump) + 1).tolist():
            before = angle_deg[max(row + 1 - _JUMP_ROWS, 0) : row + 1]
            after = angle_deg[row + 1 : row + 1 + _JUMP_ROWS]
            jump_deg = float(angle_deg[row + 1] - angle_deg[row])
            if abs(float(np.median(after) - np.median(before))) < _STAYING_SHARE * abs(jump_deg):
                continue  # the angle returns: a wrong value, not lost counts
            result.append(
                Ambiguity(
                    f"{axis}'s zero in parts of the file",
                    "the same in the whole file",
                    f"{-jump_deg:.1f} deg to add from {flight.t_s[row + 1]:.3f} s on",
                    f"{axis} jumps there by {jump_deg:.1f} deg; if the encoder lost counts, leave the rows "
                    "after the jump out with leave_out_s",
                )
            )
            break  # the first jump of an axis is reported
    return result


def _flat_tops(flight: Flight) -> list[Ambiguity]:
    """Report an angle that stops abruptly at its highest or lowest value, as at the limit of a sensor.

    The table stops the lowest elevation.
    """
    result = []
    for axis in AXES:
        angle_deg = np.degrees(getattr(flight, f"{axis}_rad"))
        step_deg = quantisation_step(angle_deg)
        ends = {"highest": float(angle_deg.max())}
        if axis != "elevation":
            ends["lowest"] = float(angle_deg.min())
        for name, end_deg in ends.items():
            spans = [
                (start, stop)
                for start, stop in runs_of(np.abs(angle_deg - end_deg) < 1e-9)
                # The motion before and after is unknown at the ends of the log.
                if (stop - 1 - start) * flight.step_s >= _FLAT_S and start and stop < angle_deg.size
            ]
            abrupt = [span for span in spans if _is_abrupt(angle_deg, span, flight.step_s, step_deg)]
            if not abrupt:
                continue
            start, stop = abrupt[0]
            result.append(
                Ambiguity(
                    f"{axis} beyond its {name} value",
                    f"{end_deg:.1f} deg, as logged",
                    f"{'more' if name == 'highest' else 'less'} than {end_deg:.1f} deg, which the sensor or "
                    "the log cannot show",
                    f"{axis} stops there abruptly, such as from {flight.t_s[start]:.2f} to "
                    f"{flight.t_s[stop - 1]:.2f} s; if it is no stop of the rig, leave these rows out with "
                    "leave_out_s",
                )
            )
    return result


def _is_abrupt(angle_deg: Floats, span: tuple[int, int], step_s: float, encoder_deg: float) -> bool:
    """Whether an angle moves fast until a flat part, and after it. Shapes: `angle_deg` (n,)."""
    start, stop = span
    # The motion is measured over the time of `_FLAT_S`, or over a fourth of a shorter part.
    rows = max(2, round(min(_FLAT_S, 0.25 * (stop - start) * step_s) / step_s))
    first, last = max(start - rows, 0), min(stop + rows - 1, angle_deg.size - 1)
    entered_deg = abs(angle_deg[start] - angle_deg[first])
    exited_deg = abs(angle_deg[last] - angle_deg[stop - 1])
    return bool(min(entered_deg, exited_deg) > _FLAT_STEPS * max(encoder_deg, _FINEST_STEP_deg))


def _held_voltages(flight: Flight, reference: Reference) -> list[Ambiguity]:
    """Report a voltage that stands still in the air while the other one or pitch changes, as over a failed
    link.
    """
    volts = {"front": flight.front_V, "back": flight.back_V}
    changes = {motor: np.diff(values) for motor, values in volts.items()}
    elevation_deg = np.degrees(flight.elevation_rad)
    aloft_deg = float(elevation_deg.min()) + _ALOFT_DEG
    pitch_fit = _regressions(flight, reference).get("pitch")
    for motor, other in (PAIR, PAIR[::-1]):
        intervals = np.diff(np.flatnonzero(changes[motor]))
        if intervals.size < _MIN_INTERVALS or pitch_fit is None:
            continue  # too few changes for a typical interval, or pitch is unknown
        typical_rows = float(np.quantile(intervals, 0.95))
        if typical_rows * flight.step_s > _MAX_INTERVAL_S:
            continue  # a voltage in slow steps stands still anyway
        held_rows = max(_HELD_S / flight.step_s, _HELD_INTERVALS * typical_rows)
        for start, last in runs_of(changes[motor] == 0.0):
            span = start, last + 1
            is_aloft = float(np.median(elevation_deg[slice(*span)])) > aloft_deg
            if last - start < held_rows or not is_aloft:
                continue  # a short time, or an arm on the table, where controllers hold voltages
            if not _changes_around(changes, motor, other, span, flight):
                continue  # the controller itself holds them, as before a start
            is_at_limit = _is_limit(volts[motor], span, _LIMIT_SHARE * held_rows)
            is_failure_at_limit = (
                is_at_limit
                and _jumps_to_limit(volts[motor], span, flight.step_s)
                and _is_ignored(flight, motor, span, pitch_fit.lag_s)
            )
            if is_at_limit and not is_failure_at_limit:
                continue  # the amplifier holds the voltage at its limit, not a failed link
            return [
                Ambiguity(
                    f"the {motor} voltage in parts of the file",
                    f"{volts[motor][start]:.2f} V, as logged from {flight.t_s[start]:.2f} to "
                    f"{flight.t_s[last]:.2f} s",
                    "unknown there",
                    f"it changes before and after, and the {other} voltage or pitch all the time; if a link "
                    "failed, leave these rows out with leave_out_s",
                )
            ]
    return []


def _changes_around(
    changes: Mapping[str, Floats], motor: str, other: str, span: tuple[int, int], flight: Flight
) -> bool:
    """Whether a voltage changes as often as usual just before and after a part, and the other one or pitch
    within.
    """
    start, stop = span
    near = max(5, round(_NEAR_S / flight.step_s))
    witness = changes[other]
    if not witness[start : stop - 1].any():
        # Both voltages may stand still; a controller would follow the motion.
        witness = np.diff(flight.pitch_rad)

    def is_changing(signal: Floats, rows: slice) -> bool:
        """Whether the changes of a signal are as frequent in some rows as in all of them."""
        part = signal[rows]
        return part.size > 0 and bool(np.mean(part != 0.0) >= _CHANGING_SHARE * np.mean(signal != 0.0))

    return (
        is_changing(changes[motor], slice(max(start - 1 - near, 0), max(start - 1, 0)))
        and is_changing(changes[motor], slice(stop, stop + near))
        and is_changing(witness, slice(start, stop - 1))
    )


def _is_limit(volts: Floats, span: tuple[int, int], held_rows: float) -> bool:
    """Whether the voltage in a part is the largest or smallest, or is held at other times, too, for as many
    rows. Shapes: `volts` (n,).
    """
    start, stop = span
    value = float(volts[start])
    is_equal: Booleans = np.abs(volts - value) < 1e-9
    is_equal[start:stop] = False
    return value in (float(volts.min()), float(volts.max())) or any(
        last - first >= held_rows for first, last in runs_of(is_equal)
    )


def _jumps_to_limit(volts: Floats, span: tuple[int, int], step_s: float) -> bool:
    """Whether a voltage jumps to a limit and from it. Shapes: `volts` (n,)."""
    start, stop = span
    near = max(5, round(_NEAR_S / step_s))
    nearby = np.concatenate((volts[max(start - 1 - near, 0) : start], volts[stop : stop + near + 1]))
    jump = min(abs(float(volts[start] - volts[start - 1])), abs(float(volts[stop] - volts[stop - 1])))
    large_step = float(np.quantile(np.abs(np.diff(nearby)), 0.9))
    limit_distance = abs(float(np.median(volts)) - float(volts[start]))
    return jump > max(_VOLTAGE_JUMP * large_step, _LIMIT_JUMP * limit_distance)


def _is_ignored(flight: Flight, motor: str, span: tuple[int, int], lag_s: float) -> bool:
    """Whether pitch, which follows the voltages after a lag, `lag_s` [s], responds as if a motor had got
    another voltage than in a part of the log.

    Amplifiers have limits, so that a voltage stands still there without a failed link.
    """
    start, stop = span
    logged_V = {"front": flight.front_V, "back": flight.back_V}
    # The other voltage: a straight line across the part.
    line_V = logged_V[motor].copy()
    ends = [start - 1, stop]
    line_V[start:stop] = np.interp(flight.t_s[start:stop], flight.t_s[ends], line_V[ends])
    bridged_V = logged_V | {motor: line_V}
    columns = {
        "pitch": flight.pitch_rad,
        "logged": logged_V["front"] - logged_V["back"],
        "bridged": bridged_V["front"] - bridged_V["back"],
    }
    table = Table("flight", {name: Column(values) for name, values in columns.items()})
    signals = column_signals(table, flight.t_s, list(columns))
    pitch = signals.filtered["pitch"]

    def regressors(cause: str) -> Floats:
        """Constant, voltage difference, rate and sine of pitch, which together accelerate pitch."""
        response = delay(signals.filtered[cause].value, lag_s)
        return np.column_stack((np.ones(response.size), response, pitch.rate, np.sin(pitch.value)))

    near = (signals.t_s > flight.t_s[start] - EDGE_S) & (signals.t_s < flight.t_s[stop] + lag_s + EDGE_S)
    others = signals.inner & ~near
    solution, *_ = np.linalg.lstsq(regressors("bridged")[others], pitch.acceleration[others], rcond=None)
    errors = {
        cause: float(np.sum((pitch.acceleration - regressors(cause) @ solution)[near & signals.inner] ** 2))
        for cause in ("logged", "bridged")
    }
    return errors["logged"] > _ERROR_RATIO * errors["bridged"]


def _decodings(table: Table, profile: Profile, rig: Rig, *, is_given: bool) -> list[Ambiguity]:
    """Report an angle whose encoder has half or twice the steps that the rig file or another axis has."""
    counts = reference_of(rig).counts
    steps_rad = {
        axis: angle.rad * quantisation_step(table.columns[angle.column].values)
        for axis, angle in profile.angles.items()
        if angle.unit != COUNT
    }
    ratios = {axis: 2.0 * math.pi / step / counts[axis] for axis, step in steps_rad.items() if step}
    suspects: Mapping[str, float] = ratios
    if not is_given:
        # Rigs have other encoders, but elevation and pitch have the same ones.
        same = {"elevation", "pitch"} <= ratios.keys()
        suspects = {"pitch": ratios["pitch"] / ratios["elevation"]} if same else {}
    return [
        Ambiguity(
            f"the scale of {axis}'s encoder",
            f"steps of {math.degrees(steps_rad[axis]):.4f} deg, as logged",
            f"{ratio:g} times the angle",
            f"the encoders {f'of rig {rig.name}' if is_given else 'of elevation'} have other steps by this "
            f"factor; a program that counts other edges of the encoder gives a wrong scale; turn {axis} by a "
            "known angle",
        )
        for axis, measured in suspects.items()
        for ratio in _DECODINGS
        if abs(measured / ratio - 1.0) < _COUNTS_TOLERANCE
    ]
