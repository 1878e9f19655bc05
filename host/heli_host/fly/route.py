"""Routes: the segments of a plan, and its setpoints as functions of time."""

from __future__ import annotations

import difflib
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple, NoReturn

import numpy as np

from heli_host.data.arrays import Floats
from heli_host.declaration import AXES
from heli_host.declaration import Excitation as Signal
from heli_host.errors import PlanError
from heli_host.link.clock import TICK_S

MAX_SEGMENT_S = 3600.0


@dataclass(frozen=True)
class Number:
    """Numbers that are valid for a key."""

    least: float  # least, most: Bounds, both included
    most: float
    excludes_least: bool = False  # Whether `least` itself is invalid
    whole: bool = False  # Whether only whole numbers are valid

    def __contains__(self, value: float) -> bool:
        return self.least <= value <= self.most and not (self.excludes_least and value == self.least)

    def __str__(self) -> str:
        if self.excludes_least:
            return f"more than {self.least:g} and at most {self.most:g}"
        return f"{self.least:g} to {self.most:g}"


ANGLE = Number(-3600.0, 3600.0)
DURATION = Number(0.0, MAX_SEGMENT_S, excludes_least=True)
PAUSE = Number(0.0, MAX_SEGMENT_S)
RATE = Number(0.1, 1000.0)
PERIOD = Number(0.2, MAX_SEGMENT_S)
FREQUENCY = Number(1.0 / MAX_SEGMENT_S, 5.0)
VOLTAGE = Number(-24.0, 24.0)
EXCITATION_HZ = Number(0.0, 500.0)
SEED = Number(0, 2**32 - 1, whole=True)

TARGETS = {f"{axis}_deg": ANGLE for axis in AXES}


class PlanTable:
    """One table of a plan, and its place in the file."""

    def __init__(self, values: Mapping[str, Any], where: str, known: Iterable[str]) -> None:
        self.values = values
        self.where = where
        names = list(known)
        for key in values:
            if key not in names:
                self.fail(f"unknown key {key!r}", _suggestion(key, names))

    def fail(self, what: str, remedy: str) -> NoReturn:
        """Raise the error of this table."""
        raise PlanError(f"{self.where}: {what}", remedy)

    def number(self, key: str, spec: Number, default: float | None = None) -> float:
        """Return a number."""
        # `default`: Value when the key is missing; without it the key must be there.
        if key not in self.values:
            if default is None:
                self.fail(f"{key} is missing", f"add {key} = {_example_value(key, spec)}")
            return default
        value = self.values[key]
        if isinstance(value, bool) or not isinstance(value, int | float):
            self.fail(
                f"{key} is {_shortened(value)}, not a number", f"write {key} = {_example_value(key, spec)}"
            )
        if not math.isfinite(value):
            self.fail(f"{key} is {value}", "give a finite number")
        if value not in spec:
            self.fail(f"{key} is {value:g}", f"give {spec}")
        if spec.whole and value != int(value):
            self.fail(f"{key} is {value:g}", "give a whole number")
        return float(value)

    def optional(self, key: str, spec: Number) -> float | None:
        """Return a number, or None when its key is missing."""
        return self.number(key, spec) if key in self.values else None

    def text(self, key: str, default: str) -> str:
        """Return a text."""
        value = self.values.get(key, default)
        if not isinstance(value, str):
            self.fail(f"{key} is {_shortened(value)}, not a text", f'write {key} = "{default or "..."}"')
        return value

    def choice(self, key: str, choices: Iterable[str], default: str | None = None) -> str:
        """Return one of several words."""
        # `default`: Value when the key is missing; without it the key must be there.
        words = list(choices)
        if key not in self.values and default is None:
            self.fail(f"{key} is missing", f"give one of {', '.join(words)}")
        value = self.values.get(key, default)
        if value not in words:
            similar_words = difflib.get_close_matches(str(value), words, n=1)
            hint = f"did you mean {similar_words[0]!r}? " if similar_words else ""
            self.fail(f"{key} is {_shortened(value)}", f"{hint}it takes {', '.join(words)}")
        return str(value)


def _example_value(key: str, spec: Number) -> str:
    if key.endswith("_s"):
        return "10"
    return f"{min(max(5.0, spec.least), spec.most):g}"


def _shortened(value: object) -> str:
    text = " ".join(repr(value).split())
    return text if len(text) <= 40 else text[:37] + "..."


def _suggestion(key: str, names: list[str]) -> str:
    """Return the advice for an unknown key: the unit, a similar key, or all keys."""
    with_unit = [name for name in names if name.startswith(key + "_")]
    if with_unit:
        return f"name the unit: {' or '.join(with_unit)}"
    close = difflib.get_close_matches(key, names, n=1, cutoff=0.6)
    return f"did you mean {close[0]!r}?" if close else f"it takes {', '.join(names)}"


Shape = Callable[[Floats], Floats]
"""From times within a piece, seconds (n,), to elevation, pitch and travel in degrees (n, axes)."""


@dataclass(frozen=True)
class PlannedExcitation:
    """An excitation that the board adds to the motor voltages during a piece."""

    signal: str  # Kind of excitation: name of a member of `heli_host.declaration.Excitation` in lower case
    front_V: float  # front_V, back_V: Amplitude on each motor
    back_V: float
    start_Hz: float  # start_Hz, stop_Hz: Frequencies
    stop_Hz: float
    duration_s: float  # Length
    seed: int  # Seed of prbs


@dataclass(frozen=True)
class Piece:
    """A stretch of a route."""

    phase: str  # Part of the flight: ``take-off`` or a plan's name
    name: str  # Kind of the piece, for messages: ``sine``, ``step`` ..
    start_s: float  # start_s, duration_s: Start on the route's time axis, and length [s]
    duration_s: float
    shape: Shape  # Function that returns the setpoints within the piece
    excitation: PlannedExcitation | None = None

    @property
    def end_deg(self) -> Floats:
        """Setpoints at its end, degrees (axes,)."""
        end_deg: Floats = self.shape(np.array([self.duration_s]))[0]
        return end_deg


@dataclass(frozen=True)
class Route:
    """Pieces that follow each other."""

    start_deg: Floats  # (axes,): Elevation, pitch and travel before the first piece
    pieces: tuple[Piece, ...] = ()  # In order of time, without gaps

    @property
    def duration_s(self) -> float:
        """Time from its start to its end, in seconds."""
        return self.pieces[-1].start_s + self.pieces[-1].duration_s if self.pieces else 0.0

    @property
    def end_deg(self) -> Floats:
        """Setpoints at its end, degrees (axes,)."""
        return self.pieces[-1].end_deg if self.pieces else self.start_deg

    @cached_property
    def _starts_s(self) -> Floats:
        return np.array([piece.start_s for piece in self.pieces])

    def then(
        self,
        phase: str,
        name: str,
        duration_s: float,
        shape: Shape,
        excitation: PlannedExcitation | None = None,
    ) -> Route:
        """Return the route with one more piece."""
        piece = Piece(
            phase=phase,
            name=name,
            start_s=self.duration_s,
            duration_s=duration_s,
            shape=shape,
            excitation=excitation,
        )
        return Route(self.start_deg, (*self.pieces, piece))

    def piece_at(self, t_s: float) -> Piece | None:
        """Return the piece at a time."""
        if not self.pieces or t_s < 0.0 or t_s >= self.duration_s:
            return None
        return self.pieces[max(0, int(np.searchsorted(self._starts_s, t_s, side="right")) - 1)]

    def evaluate(self, t_s: Floats) -> Floats:
        """Return the setpoints. Shapes: `t_s` (n,); returns (n, axes)."""
        setpoints_deg = np.empty((t_s.size, self.start_deg.size))
        setpoints_deg[:] = self.start_deg
        if not self.pieces:
            return setpoints_deg
        index = np.searchsorted(self._starts_s, t_s, side="right") - 1
        for number in set(index.tolist()) - {-1}:
            piece = self.pieces[number]
            is_in_piece = index == number
            setpoints_deg[is_in_piece] = piece.shape(
                np.minimum(t_s[is_in_piece] - piece.start_s, piece.duration_s)
            )
        return setpoints_deg


def hold(at_deg: Floats) -> Shape:
    """Return a shape that stays. Shapes: `at_deg` (axes,)."""
    return lambda t_s: np.tile(at_deg, (t_s.size, 1))


def ramp(from_deg: Floats, to_deg: Floats, duration_s: float) -> Shape:
    """Return a shape that goes straight from one point to another. Shapes: `from_deg, to_deg` (axes,)."""
    return lambda t_s: from_deg + np.outer(np.clip(t_s / duration_s, 0.0, 1.0), to_deg - from_deg)


def sine(from_deg: Floats, amplitude_deg: Floats, period_s: Floats, duration_s: float) -> Shape:
    """Return sines about the present point, faded in and out so that neither setpoint nor its rate jumps.
    Shapes: `from_deg` (axes,), `amplitude_deg` (axes,), `period_s` (axes,).
    """
    fades_s = fade_s(period_s, duration_s)

    def shape(t_s: Floats) -> Floats:
        column = t_s[:, None]
        envelope = _smooth_from_0_to_1(np.clip(np.minimum(column, duration_s - column) / fades_s, 0.0, 1.0))
        return from_deg + amplitude_deg * envelope * np.sin(2.0 * np.pi * column / period_s)

    return shape


def fade_s(period_s: Floats, duration_s: float) -> Floats:
    """Return how long a sine takes to reach its amplitude. Shapes: `period_s` (axes,)."""
    # Over half a period the rate never exceeds that of the full sine, and its acceleration by a third at
    # most.
    return np.minimum(0.5 * period_s, 0.5 * duration_s)


def waypoints(at_s: Sequence[Floats], points_deg: Sequence[Floats], smooth: bool) -> Shape:
    """Return a path through points. Shapes: `at_s` (m,), `points_deg` (m,)."""

    def shape(t_s: Floats) -> Floats:
        columns = []
        for times, values in zip(at_s, points_deg, strict=True):
            if not smooth or times.size < 2:
                columns.append(np.interp(t_s, times, values))
                continue
            segment = np.clip(np.searchsorted(times, t_s, side="right") - 1, 0, times.size - 2)
            elapsed_share = np.clip((t_s - times[segment]) / (times[segment + 1] - times[segment]), 0.0, 1.0)
            columns.append(
                values[segment] + _smooth_from_0_to_1(elapsed_share) * (values[segment + 1] - values[segment])
            )
        return np.column_stack(columns)

    return shape


def _smooth_from_0_to_1(share: Floats) -> Floats:
    """Go from 0 to 1 with level ends."""
    return share * share * (3.0 - 2.0 * share)


SIGNALS = tuple(signal.name.lower() for signal in Signal if signal is not Signal.NONE)
_SHAPES_OF_PATH = ("smooth", "straight")
_SMOOTH_PEAK = 1.5
"""Steepest slope of the cubic blend, as a multiple of the mean slope."""


@dataclass(frozen=True)
class Motion:
    """Motion of a segment from its first setpoints."""

    duration_s: float  # Its length
    shape: Shape  # Setpoints within it
    low_deg: Floats  # low_deg, high_deg: (axes,): Bounds of elevation, pitch and travel within it
    high_deg: Floats
    rate_deg_s: Floats
    """(axes,): Steepest requested slopes; 0 for a step, because the board's slew limit shapes it."""


@dataclass(frozen=True)
class Segment:
    """One segment of a plan."""

    kind: str  # ``hold``, ``step``, ``ramp``, ``sine``, ``waypoints``, ``excite`` or ``land``
    where: str  # File and segment, for messages
    motion: Callable[[Floats], Motion]
    """Returns the `Motion` of the segment, given the setpoints at its beginning, degrees (axes,)."""
    limit_keys: tuple[str, ...] = tuple(TARGETS)
    """For each axis, the key that an error names if the motion leaves the limits."""
    rate_key: str = "duration_s"  # The key that an error names if the motion is too fast
    excitation: PlannedExcitation | None = None


def read_segment(values: Mapping[str, Any], where: str, commanded: tuple[str, ...]) -> Segment:
    """Read one segment."""
    kind_only = PlanTable({key: values[key] for key in ("kind",) if key in values}, where, ("kind",))
    kind = kind_only.choice("kind", _KINDS)
    where = f"{where} ({kind})"
    keys, reader = _KINDS[kind]
    usable_keys = [key for key in keys if _axis_of(key) is None or _axis_of(key) in commanded]
    for key in values:
        axis = _axis_of(key)
        if key in keys and axis is not None and axis not in commanded:
            kind_only.where = where
            remedy = 'set axes = ["elevation", "pitch"] to command pitch' if axis == "pitch" else "remove it"
            kind_only.fail(f"{key} has no effect: this plan {_reason_not_commanded(axis)}", remedy)
    return reader(PlanTable(values, where, ("kind", *usable_keys)), commanded)


def _axis_of(key: str) -> str | None:
    """Return the axis with whose name a key begins; None for a key of all axes."""
    return next((axis for axis in AXES if key.startswith(axis + "_")), None)


def _reason_not_commanded(axis: str) -> str:
    """Explain why a plan does not command an axis, for a message."""
    if axis == "pitch":
        return "closes travel, whose loop commands pitch"
    return f"does not close {axis}"


def _motion_within(
    duration_s: float, shape: Shape, *points_deg: Floats, rate_deg_s: Floats | None = None
) -> Motion:
    """Return a motion that stays within the range of some points [deg]; `rate_deg_s` has the greatest rate of
    each axis, 0 for a jump.
    """
    points = np.array(points_deg)
    rate = np.zeros(len(AXES)) if rate_deg_s is None else rate_deg_s
    return Motion(duration_s, shape, points.min(axis=0), points.max(axis=0), rate)


def _target_replacer(table: PlanTable, commanded: tuple[str, ...]) -> Callable[[Floats], Floats]:
    """Return a function that replaces setpoints [deg], shape (3,), by the targets that a table states."""
    targets_deg = {axis: table.optional(f"{axis}_deg", ANGLE) for axis in AXES}
    if all(value is None for value in targets_deg.values()):
        names = " or ".join(f"{axis}_deg" for axis in commanded)
        table.fail("it moves no axis", f"add {names}")

    def with_targets(from_deg: Floats) -> Floats:
        """Replace the setpoints of the axes that have a target."""
        to_deg = from_deg.copy()
        for index, axis in enumerate(AXES):
            value = targets_deg[axis]
            if value is not None:
                to_deg[index] = value
        return to_deg

    return with_targets


def _read_hold(table: PlanTable, commanded: tuple[str, ...]) -> Segment:
    """Read a segment that keeps the setpoints of its beginning."""
    duration_s = table.number("duration_s", DURATION)
    return Segment(
        "hold",
        table.where,
        lambda at: _motion_within(duration_s, hold(at), at),
        excitation=_read_simultaneous_excitation(table, duration_s),
    )


def _read_step(table: PlanTable, commanded: tuple[str, ...]) -> Segment:
    """Read a segment whose setpoints jump to the target, and stay there."""
    duration_s = table.number("duration_s", DURATION)
    with_targets = _target_replacer(table, commanded)

    def motion_from(begin: Floats) -> Motion:
        """Return the motion from a setpoint; its range covers the begin and the target."""
        target = with_targets(begin)
        return _motion_within(duration_s, hold(target), begin, target)

    return Segment(
        "step",
        table.where,
        motion_from,
        excitation=_read_simultaneous_excitation(table, duration_s),
    )


def _read_ramp(table: PlanTable, commanded: tuple[str, ...]) -> Segment:
    """Read a segment whose setpoints go to the target at a constant rate, or within a given time."""
    stated_duration_s = table.optional("duration_s", DURATION)
    stated_rate_deg_s = table.optional("rate_deg_s", RATE)
    if (stated_duration_s is None) == (stated_rate_deg_s is None):
        table.fail("it needs duration_s or rate_deg_s, one of them", "add duration_s = 5 or rate_deg_s = 5")
    with_targets = _target_replacer(table, commanded)

    def motion(at: Floats) -> Motion:
        """Return the ramp from the setpoints `at`, degrees (axes,), to the targets."""
        target_deg = with_targets(at)
        distance_deg = np.abs(target_deg - at)
        duration_s = stated_duration_s or 0.0
        if stated_rate_deg_s is not None:
            # The axis with the longest way moves at this rate, the others slower.
            duration_s = float(distance_deg.max()) / stated_rate_deg_s
        # A ramp to the present setpoint still takes a tick, so that its rate is finite.
        duration_s = max(duration_s, TICK_S)
        return _motion_within(
            duration_s, ramp(at, target_deg, duration_s), at, target_deg, rate_deg_s=distance_deg / duration_s
        )

    rate_key = "duration_s" if stated_duration_s is not None else "rate_deg_s"
    return Segment("ramp", table.where, motion, rate_key=rate_key)


def _read_sine(table: PlanTable, commanded: tuple[str, ...]) -> Segment:
    """Read a segment whose setpoints oscillate about those of its beginning, each axis with its amplitude and
    period.
    """
    duration_s = table.number("duration_s", DURATION)
    amplitude_deg = np.array([table.number(f"{axis}_amplitude_deg", ANGLE, 0.0) for axis in AXES])
    if not amplitude_deg.any():
        table.fail("it moves no axis", f"add {commanded[-1]}_amplitude_deg = 5")
    period_s = np.ones(len(AXES))  # Any number will do for an axis that does not move.
    shared_period_s = _read_period(table, prefix="")
    for index, axis in enumerate(AXES):
        axis_period_s = _read_period(table, prefix=f"{axis}_")
        if amplitude_deg[index] == 0.0:
            if axis_period_s is not None:
                table.fail(
                    f"{axis} has a period but no amplitude", f"add {axis}_amplitude_deg, or remove the period"
                )
            continue
        axis_period_s = axis_period_s if axis_period_s is not None else shared_period_s
        if axis_period_s is None:
            table.fail(f"{axis}_period_s is missing", f"add {axis}_period_s or {axis}_frequency_Hz")
        period_s[index] = axis_period_s

    def motion(at: Floats) -> Motion:
        """Return the sine about the setpoints `at`, degrees (axes,), with its ends faded in and out."""
        reach_deg = np.abs(amplitude_deg)
        rate_deg_s = reach_deg * 2.0 * np.pi / period_s
        fades_s = fade_s(period_s, duration_s)
        # A short fade adds its own rate to that of the sine; see `fade_s`.
        rate_deg_s += np.where(fades_s < 0.5 * period_s, reach_deg * _SMOOTH_PEAK / fades_s, 0.0)
        shape = sine(at, amplitude_deg, period_s, duration_s)
        return _motion_within(duration_s, shape, at - reach_deg, at + reach_deg, rate_deg_s=rate_deg_s)

    keys = tuple(f"{axis}_amplitude_deg" for axis in AXES)
    return Segment(
        "sine",
        table.where,
        motion=motion,
        limit_keys=keys,
        rate_key="period_s",
        excitation=_read_simultaneous_excitation(table, duration_s),
    )


def _read_period(table: PlanTable, prefix: str) -> float | None:
    """Return a period [s], stated as such or as a frequency; None if neither is stated. `prefix` is that of
    an axis, or empty for all axes.
    """
    period_s = table.optional(f"{prefix}period_s", PERIOD)
    frequency_Hz = table.optional(f"{prefix}frequency_Hz", FREQUENCY)
    if period_s is not None and frequency_Hz is not None:
        table.fail(f"both {prefix}period_s and {prefix}frequency_Hz are given", "remove one of them")
    return 1.0 / frequency_Hz if frequency_Hz is not None else period_s


class _AxisPoint(NamedTuple):
    """A point of the path of one axis."""

    at_s: float
    angle_deg: float


def _read_points(table: PlanTable, commanded: tuple[str, ...]) -> tuple[float, list[list[_AxisPoint]]]:
    """Return the time of the last point, and the points of each axis."""
    rows = table.values.get("points")
    if not isinstance(rows, list) or not rows or not all(isinstance(row, dict) for row in rows):
        table.fail("points is not a list of points", "write points = [{at_s = 5, travel_deg = 10}, ...]")
    points_of_axes: list[list[_AxisPoint]] = [[] for _ in AXES]
    usable_keys = ("at_s", *(key for key in TARGETS if _axis_of(key) in commanded))
    last_s = -1.0
    for number, row in enumerate(rows, start=1):
        point = PlanTable(row, f"{table.where}, point {number}", usable_keys)
        at_s = point.number("at_s", PAUSE)
        if at_s <= last_s:
            point.fail(f"at_s is {at_s:g}, not behind the point before it", "sort the points by at_s")
        last_s = at_s
        if len(row) < 2:
            point.fail("it moves no axis", f"add {usable_keys[-1]}")
        for axis, points in zip(AXES, points_of_axes, strict=True):
            angle_deg = point.optional(f"{axis}_deg", ANGLE)
            if angle_deg is not None:
                points.append(_AxisPoint(at_s, angle_deg))
    if last_s <= 0.0:
        table.fail("all points are at 0 s", "give the last point an at_s above 0")
    return last_s, points_of_axes


def _read_waypoints(table: PlanTable, commanded: tuple[str, ...]) -> Segment:
    """Read a segment through points in time. Each axis has its own points; an axis without any keeps its
    setpoint.
    """
    is_smooth = table.choice("path", _SHAPES_OF_PATH, "smooth") == "smooth"
    last_s, points_of_axes = _read_points(table, commanded)
    duration_s = table.number("duration_s", DURATION, last_s)
    if duration_s < last_s:
        table.fail(
            f"duration_s is {duration_s:g}, the last point is at {last_s:g} s", "make it longer, or remove it"
        )

    def motion(at: Floats) -> Motion:
        """Return the motion from the setpoints `at`, degrees (axes,), through the points."""
        # Each list has an array per axis, of as many elements as the axis has points.
        times_s, angles_deg = [], []
        for given_points, start_deg in zip(points_of_axes, at, strict=True):
            has_start = bool(given_points) and given_points[0].at_s == 0.0
            points = given_points if has_start else [_AxisPoint(0.0, float(start_deg)), *given_points]
            times_s.append(np.array([point.at_s for point in points]))
            angles_deg.append(np.array([point.angle_deg for point in points]))
        slopes_deg_s = [
            np.diff(axis_deg) / np.diff(axis_s) for axis_s, axis_deg in zip(times_s, angles_deg, strict=True)
        ]
        peak_ratio = _SMOOTH_PEAK if is_smooth else 1.0
        return Motion(
            duration_s,
            shape=waypoints(times_s, angles_deg, is_smooth),
            low_deg=np.minimum([axis_deg.min() for axis_deg in angles_deg], at),
            high_deg=np.maximum([axis_deg.max() for axis_deg in angles_deg], at),
            rate_deg_s=np.array(
                [peak_ratio * float(np.max(np.abs(slopes), initial=0.0)) for slopes in slopes_deg_s]
            ),
        )

    return Segment(
        "waypoints",
        table.where,
        motion,
        rate_key="at_s",
        excitation=_read_simultaneous_excitation(table, duration_s),
    )


def _read_excite(table: PlanTable, commanded: tuple[str, ...]) -> Segment:
    """Read a segment that keeps the setpoints, while the board adds an excitation to the voltages."""
    duration_s = table.number("duration_s", DURATION)
    return Segment(
        "excite",
        table.where,
        lambda at: _motion_within(duration_s, hold(at), at),
        excitation=_read_excitation_table(table, duration_s),
    )


def _read_simultaneous_excitation(table: PlanTable, duration_s: float) -> PlannedExcitation | None:
    """What the board adds to the voltages while a segment moves."""
    values = table.values.get("excite")
    if values is None:
        return None
    if not isinstance(values, dict):
        example = (
            'excite = { signal = "multisine", front_V = 0.25, back_V = 0.25, start_Hz = 0.1, stop_Hz = 4 }'
        )
        table.fail("excite is not a table", f"write {example}")
    return _read_excitation_table(PlanTable(values, f"{table.where}, excite", _EXCITE_KEYS), duration_s)


def _read_excitation_table(table: PlanTable, duration_s: float) -> PlannedExcitation:
    """Read an excitation: a signal for one or both motors, and the frequencies that it needs."""
    signal = table.choice("signal", SIGNALS)
    front_V = table.number("front_V", VOLTAGE, 0.0)
    back_V = table.number("back_V", VOLTAGE, 0.0)
    if front_V == 0.0 and back_V == 0.0:
        table.fail("it excites no motor", "add front_V = 0.25 or back_V = 0.25")
    needs_start = signal in ("chirp", "multisine")
    needs_stop = needs_start or signal == "prbs"
    for key, is_needed in (("start_Hz", needs_start), ("stop_Hz", needs_stop)):
        if key in table.values and not is_needed:
            table.fail(f"{key} has no effect on a {signal}", "remove it")
    start_Hz = table.number("start_Hz", EXCITATION_HZ, None if needs_start else 0.0)
    stop_Hz = table.number("stop_Hz", EXCITATION_HZ, None if needs_stop else 0.0)
    if needs_start and stop_Hz <= start_Hz:
        table.fail(f"stop_Hz is {stop_Hz:g}, start_Hz {start_Hz:g}", "make stop_Hz the higher one")
    if signal == "prbs" and stop_Hz == 0.0:
        table.fail("stop_Hz is 0", "give the rate at which the prbs may switch, such as 10")
    seed = int(table.number("seed", SEED, 1))
    # From a seed of 0, the board's generator would only return zeros.
    if signal == "prbs" and seed == 0:
        table.fail("seed is 0", "give a whole number from 1")
    return PlannedExcitation(
        signal=signal,
        front_V=front_V,
        back_V=back_V,
        start_Hz=start_Hz,
        stop_Hz=stop_Hz,
        duration_s=duration_s,
        seed=seed,
    )


def _read_land(table: PlanTable, commanded: tuple[str, ...]) -> Segment:
    return Segment("land", table.where, lambda at: _motion_within(0.0, hold(at), at))


_SINE_KEYS = tuple(
    f"{axis}_{name}" for axis in AXES for name in ("amplitude_deg", "period_s", "frequency_Hz")
)

_EXCITE_KEYS = ("signal", "front_V", "back_V", "start_Hz", "stop_Hz", "seed")

_KINDS: dict[str, tuple[tuple[str, ...], Callable[[PlanTable, tuple[str, ...]], Segment]]] = {
    "hold": (("duration_s", "excite"), _read_hold),
    "step": ((*TARGETS, "duration_s", "excite"), _read_step),
    "ramp": ((*TARGETS, "duration_s", "rate_deg_s"), _read_ramp),
    "sine": ((*_SINE_KEYS, "period_s", "frequency_Hz", "duration_s", "excite"), _read_sine),
    "waypoints": (("points", "path", "duration_s", "excite"), _read_waypoints),
    "excite": ((*_EXCITE_KEYS, "duration_s"), _read_excite),
    "land": ((), _read_land),
}
