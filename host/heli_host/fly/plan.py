"""Flight plans: TOML in, setpoints as functions of time out; everything is checked before anything moves.

::

    title = "Travel step"
    [start]                      # where take-off ends; all of it may be left out
    elevation_deg = 0
    rate_deg_s = 8               # how fast the elevation setpoint rises from the table
    settle_s = 4                 # wait there before the first segment

    [tolerance]                  # farther from its setpoint for longer, and the flight was not tracked
    elevation_deg = 3

    [[segment]]
    kind = "hold"                # hold, step, ramp, sine, waypoints, excite, land
    duration_s = 5
    [[segment]]
    kind = "step"
    travel_deg = 15
    duration_s = 12

A plan closes all axes unless ``axes = ["elevation", "pitch"]`` leaves travel free; only then ``pitch_deg`` is
taken. Setpoints are continuous from segment to segment, steps excepted; every plan ends in a landing.
"""

from __future__ import annotations

import difflib
import errno
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from importlib import resources
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from heli_host.board.flying import setpoint_bounds
from heli_host.data.arrays import Floats
from heli_host.data.files import TOML_BYTES, decode_text, parse_toml, read_file
from heli_host.data.response import TAKE_OFF
from heli_host.declaration import AXES, PARAMS, Axis
from heli_host.errors import PlanError, file_remedy
from heli_host.fly import route as shapes
from heli_host.fly.route import (
    ANGLE,
    PAUSE,
    RATE,
    PlannedExcitation,
    PlanTable,
    Route,
    Segment,
    read_segment,
)
from heli_host.fly.tracking import Tolerance

_TABLE_MARGIN_DEG = 2.0


@dataclass(frozen=True)
class Limits:
    """Limits of a board for a plan."""

    low_deg: Floats  # low_deg, high_deg: (axes,): Bounds of the setpoints of elevation, pitch and travel
    high_deg: Floats
    low_names: tuple[str, ...]  # low_names, high_names: Source of each bound, for messages
    high_names: tuple[str, ...]
    slew_deg_s: Floats  # (axes,): Fastest change of each setpoint
    excitation_max_V: float  # excitation_max_V, excitation_max_s: Bounds of an excitation
    excitation_max_s: float
    rest_deg: float  # Elevation on the table

    @staticmethod
    def of(parameters: Mapping[str, float] | None = None) -> Limits:
        """Return the limits that parameters set."""
        values = {spec.name: spec.default for spec in PARAMS}
        values.update(parameters or {})
        bounds = setpoint_bounds(values)
        low_deg = np.array([bounds[axis].least_deg for axis in AXES])
        low_deg[Axis.ELEVATION] = values["elevation_rest_deg"] + _TABLE_MARGIN_DEG
        low_names = [bounds[axis].least_name for axis in AXES]
        low_names[Axis.ELEVATION] = f"elevation_rest_deg + {_TABLE_MARGIN_DEG:g}"
        return Limits(
            low_deg=low_deg,
            high_deg=np.array([bounds[axis].most_deg for axis in AXES]),
            low_names=tuple(low_names),
            high_names=tuple(bounds[axis].most_name for axis in AXES),
            slew_deg_s=np.array([values[f"{axis}_slew_deg_s"] for axis in AXES]),
            excitation_max_V=values["excitation_max_V"],
            excitation_max_s=values["excitation_max_s"],
            rest_deg=values["elevation_rest_deg"],
        )


def check_motion(segment: Segment, at_deg: Floats, limits: Limits) -> None:
    """Refuse a segment that the board would refuse, or could not follow. Shapes: `at_deg` (axes,)."""
    motion = segment.motion(at_deg)
    # Rounding errors of a path that just touches a limit are no violation.
    rounding = 1e-9
    for index, axis in enumerate(AXES):
        key = segment.limit_keys[index]
        low_deg, high_deg = limits.low_deg[index], limits.high_deg[index]
        if motion.high_deg[index] > high_deg + rounding:
            raise PlanError(
                f"{segment.where}: {key} takes {axis} to {motion.high_deg[index]:g} degrees",
                f"stay at or below {high_deg:g} ({limits.high_names[index]})",
            )
        if motion.low_deg[index] < low_deg - rounding:
            raise PlanError(
                f"{segment.where}: {key} takes {axis} to {motion.low_deg[index]:g} degrees",
                f"stay at or above {low_deg:g} ({limits.low_names[index]})",
            )
        rate_deg_s = motion.rate_deg_s[index]
        if rate_deg_s > limits.slew_deg_s[index] * (1.0 + rounding):
            raise PlanError(
                f"{segment.where}: {segment.rate_key} moves {axis} by {rate_deg_s:.4g} degrees per second",
                f"the board's {axis}_slew_deg_s is {limits.slew_deg_s[index]:g}; lower the rate, or "
                "raise that parameter",
            )
    if segment.excitation is not None:
        _check_excitation(segment.excitation, segment.where, limits)


def _check_excitation(excitation: PlannedExcitation, where: str, limits: Limits) -> None:
    """Refuse an excitation that is too large or too long for the board."""
    for key, value in (("front_V", excitation.front_V), ("back_V", excitation.back_V)):
        if abs(value) > limits.excitation_max_V:
            raise PlanError(
                f"{where}: {key} is {value:g}",
                f"keep it within {limits.excitation_max_V:g} (excitation_max_V)",
            )
    if excitation.duration_s > limits.excitation_max_s:
        raise PlanError(
            f"{where}: duration_s is {excitation.duration_s:g}",
            f"keep it within {limits.excitation_max_s:g} (excitation_max_s)",
        )


MAX_SEGMENTS = 1000


@dataclass(frozen=True)
class Start:
    """Start of a plan: the end of the take-off, or the transition from the plan before."""

    elevation_deg: float = 0.0  # Elevation there
    rate_deg_s: float = 8.0  # Rate at which the elevation setpoint rises to this elevation
    settle_s: float = 4.0  # Waiting time at this elevation


class PlanSetpoints(NamedTuple):
    """Setpoints of a plan in degrees: float, or ndarray (n,)."""

    elevation_deg: Any
    pitch_deg: Any
    travel_deg: Any


@dataclass(frozen=True)
class Plan:
    """A flight plan, read and checked.

    Parameters
    ----------
    name : str
        Name of the plan, or the stem of its file.
    source : str
        Built-in name or path, for messages.
    title : str
        Description of the plan in one line.
    axes : tuple of str
        Axes in closed loop.
    text : str
        TOML text of the plan, unchanged; it is written to the log.
    """

    name: str
    source: str
    title: str
    axes: tuple[str, ...]
    start: Start
    segments: tuple[Segment, ...]
    text: str
    tolerance: Tolerance

    @cached_property
    def setpoint_range_deg(self) -> float:
        """Range of the setpoints after the take-off, the largest of all axes [deg]; 0 if the plan only
        holds.
        """
        at_deg = np.array([self.start.elevation_deg, 0.0, 0.0])
        low_deg = high_deg = at_deg
        for segment in self.segments:
            if segment.kind != "land":
                motion = segment.motion(at_deg)
                low_deg = np.minimum(low_deg, motion.low_deg)
                high_deg = np.maximum(high_deg, motion.high_deg)
                at_deg = motion.shape(np.array([motion.duration_s]))[0]
        return float((high_deg - low_deg).max())

    @staticmethod
    def parse(text: str, source: str, name: str = "") -> Plan:
        """Read a plan.

        Parameters
        ----------
        text : str
            TOML.
        source : str
            Built-in name or path, for messages.
        name : str
            Name of the plan; the source's stem without it.

        Raises
        ------
        PlanError
            If the text is not TOML, has an unknown key, lacks a key, or has a value that no board accepts.
        """
        try:
            values = parse_toml(text)
        except ValueError as error:
            raise PlanError(f"{source} is not TOML: {error}", "correct that line") from error
        return Plan.of_tables(values, text, source, name)

    @staticmethod
    def of_tables(values: dict[str, Any], text: str, source: str, name: str = "") -> Plan:
        """Read a plan from its parsed tables.

        Parameters
        ----------
        values : dict
            The tables of `text`.
        text, source, name : str
            As those of `parse`.

        Raises
        ------
        PlanError
            If a table has an unknown key, lacks a key, or has a value that no board accepts.
        """
        name = name or Path(source).stem
        table = PlanTable(values, source, ("title", "axes", "start", "tolerance", "segment"))
        closed_axes = _read_axes(table)
        commanded_axes = closed_axes
        if "travel" in closed_axes:
            # The loop of travel commands pitch itself.
            commanded_axes = tuple(axis for axis in closed_axes if axis != "pitch")
        start = _read_start(values.get("start", {}), source)
        tolerance_table = values.get("tolerance", {})
        if not isinstance(tolerance_table, dict):
            table.fail("tolerance is not a table", "write [tolerance] above its keys")
        rows = values.get("segment", [])
        if not isinstance(rows, list) or not rows or not all(isinstance(row, dict) for row in rows):
            table.fail("it has no segment", 'add one: [[segment]] with kind = "hold" and duration_s = 10')
        if len(rows) > MAX_SEGMENTS:
            table.fail(f"it has {len(rows)} segments", f"use at most {MAX_SEGMENTS}")
        segments = tuple(
            read_segment(row, f"{source}, segment {number}", commanded_axes)
            for number, row in enumerate(rows, start=1)
        )
        for segment in segments[:-1]:
            if segment.kind == "land":
                raise PlanError(f"{segment.where}: another segment follows", "put land last, or leave it out")
        tolerance = Tolerance.read(tolerance_table, f"{source}, tolerance")
        return Plan(
            name=name,
            source=source,
            title=table.text("title", name),
            axes=closed_axes,
            start=start,
            segments=segments,
            text=text,
            tolerance=tolerance,
        )

    @cached_property
    def route(self) -> Route:
        """The plan as setpoints over time; 0 s is when take-off has settled."""
        return extend(Route(self._start_deg), self)

    @property
    def _start_deg(self) -> Floats:
        start_deg = np.zeros(len(AXES))
        start_deg[Axis.ELEVATION] = self.start.elevation_deg
        return start_deg

    @property
    def duration_s(self) -> float:
        """Length without take-off and landing, in seconds."""
        return self.route.duration_s

    def evaluate(self, t_s: float | NDArray[np.float64]) -> PlanSetpoints:
        """Return the setpoints at one time or many.

        Parameters
        ----------
        t_s : float or ndarray (n,)
            Seconds since take-off has settled.

        Returns
        -------
        PlanSetpoints
            Before 0 s those at the start of the plan, and after its end the last ones.
        """
        points = self.route.evaluate(np.atleast_1d(np.asarray(t_s, np.float64)))
        return PlanSetpoints(*(points[0].tolist() if np.ndim(t_s) == 0 else points.T))

    def check(self, parameters: Mapping[str, float] | None = None, from_deg: Floats | None = None) -> Floats:
        """Refuse a plan that the board would refuse or could not follow.

        Parameters
        ----------
        parameters : Mapping[str, float], optional
            The board's parameters; a missing parameter has its declared default.
        from_deg : ndarray (axes,), optional
            Setpoints at which the plan begins; its own start without it.

        Returns
        -------
        ndarray (axes,)
            Setpoints at which the plan ends, in degrees.

        Raises
        ------
        PlanError
            If a setpoint leaves the limits, changes faster than the board's slew limits, or an excitation is
            too large or too long; the message names file, segment and key.
        """
        at_deg = self._start_deg if from_deg is None else from_deg.copy()
        limits = Limits.of(parameters)
        self._check_start(limits)
        # The take-off, or the way from the plan before, goes to the elevation at which this plan starts.
        at_deg[Axis.ELEVATION] = self.start.elevation_deg
        for segment in self.segments:
            check_motion(segment, at_deg, limits)
            at_deg = _end_deg_of(segment, at_deg)
        return at_deg

    def _check_start(self, limits: Limits) -> None:
        """Refuse a take-off height or rate that the board's limits do not permit."""
        low, high = limits.low_deg[Axis.ELEVATION], limits.high_deg[Axis.ELEVATION]
        if not low <= self.start.elevation_deg <= high:
            raise PlanError(
                f"{self.source}, start: elevation_deg is {self.start.elevation_deg:g}",
                f"keep it from {low:g} to {high:g}",
            )
        if self.start.rate_deg_s > limits.slew_deg_s[Axis.ELEVATION]:
            raise PlanError(
                f"{self.source}, start: rate_deg_s is {self.start.rate_deg_s:g}, the board's "
                f"elevation_slew_deg_s {limits.slew_deg_s[Axis.ELEVATION]:g}",
                "lower it, or raise the parameter",
            )


def load_plan(name: str | Path) -> Plan:
    """Find and read a plan.

    Parameters
    ----------
    name : str or Path
        Name of a built-in plan, or path of a TOML file.

    Raises
    ------
    PlanError
        If there is no such plan, or it cannot be flown as written.
    """
    text = str(name)
    if text in plan_names():
        content = (_built_in_folder() / f"{text}.toml").read_text(encoding="utf-8")
        return Plan.parse(content, source=f"plan {text}", name=text)
    path = Path(name)
    if not path.exists():
        close = difflib.get_close_matches(text, plan_names(), n=1)
        hint = f"did you mean {close[0]}? " if close else ""
        raise PlanError(
            f"unknown plan {text!r}", f"{hint}give a TOML file, or one of: {', '.join(plan_names())}"
        )
    try:
        return Plan.parse(decode_text(read_file(path, TOML_BYTES)), source=str(path), name=path.stem)
    except UnicodeDecodeError as error:
        raise PlanError(f"{path} is not text in UTF-8", "give a TOML file") from error
    except OSError as error:
        if error.errno == errno.EFBIG:
            raise PlanError(
                f"{path} is too large for a flight plan", "give a TOML file; to repeat a log, use --again"
            ) from error
        raise PlanError(f"cannot read {path}: {error.strerror or error}", file_remedy(error)) from error


def plan_names() -> list[str]:
    """Return the names of the built-in plans."""
    return sorted(
        entry.name.removesuffix(".toml")
        for entry in _built_in_folder().iterdir()
        if entry.name.endswith(".toml")
    )


def take_off(plans: Sequence[Plan], parameters: Mapping[str, float], start_deg: Floats) -> Route:
    """Join take-off and plans to one route, checked against a board. Shapes: `start_deg` (axes,)."""
    first = plans[0]
    for plan in plans[1:]:
        if plan.axes != first.axes:
            raise PlanError(
                f"{plan.source} closes {', '.join(plan.axes)}, {first.source} {', '.join(first.axes)}",
                "fly them one after the other, each with its own command",
            )
    at_deg = start_deg.copy()
    at_deg[Axis.PITCH] = 0.0
    route = Route(at_deg)
    for plan in plans:
        at_deg = plan.check(parameters, at_deg)
    for number, plan in enumerate(plans):
        route = extend(
            _with_way_to_start(route, plan, TAKE_OFF if number == 0 else plan.name, settle=number == 0), plan
        )
    return route


def extend(route: Route, plan: Plan) -> Route:
    """Append a plan's segments to a route."""
    for segment in plan.segments:
        motion = segment.motion(route.end_deg)
        if motion.duration_s > 0.0:
            route = route.then(plan.name, segment.kind, motion.duration_s, motion.shape, segment.excitation)
    return route


def _with_way_to_start(route: Route, plan: Plan, phase: str, *, settle: bool) -> Route:
    """Add the way from the end of a route to the first elevation of a plan, and the time to settle there."""
    from_deg = route.end_deg
    to_deg = from_deg.copy()
    to_deg[Axis.ELEVATION] = plan.start.elevation_deg
    duration_s = float(np.abs(to_deg - from_deg).max()) / plan.start.rate_deg_s
    if duration_s > 0.0:
        route = route.then(phase, "rise", duration_s, shapes.ramp(from_deg, to_deg, duration_s))
    if settle and plan.start.settle_s > 0.0:
        route = route.then(phase, "settle", plan.start.settle_s, shapes.hold(to_deg))
    return route


def _end_deg_of(segment: Segment, at_deg: Floats) -> Floats:
    motion = segment.motion(at_deg)
    end_deg: Floats = motion.shape(np.array([motion.duration_s]))[0]
    return end_deg


def _read_axes(table: PlanTable) -> tuple[str, ...]:
    """Return the axes whose loops a plan closes, in the order of the declaration; all if it states none."""
    stated_axes = table.values.get("axes", list(AXES))
    if (
        not isinstance(stated_axes, list)
        or not all(axis in AXES for axis in stated_axes)
        or len(set(stated_axes)) != len(stated_axes)
    ):
        table.fail(
            f"axes is {stated_axes!r:.60}, not a list of different axes",
            f"write axes = {list(AXES)}".replace("'", '"'),
        )
    if "elevation" not in stated_axes or "pitch" not in stated_axes:
        table.fail(
            "axes lacks elevation or pitch",
            "a plan closes both; fly open loop from Python with heli.control()",
        )
    return tuple(axis for axis in AXES if axis in stated_axes)


def _read_start(values: Any, source: str) -> Start:
    """Read the table ``[start]`` of a plan: elevation, rate and settling time of the take-off."""
    if not isinstance(values, dict):
        raise PlanError(f"{source}: [start] is not a table", "write [start] above its keys")
    table = PlanTable(values, f"{source}, start", ("elevation_deg", "rate_deg_s", "settle_s"))
    default_start = Start()
    return Start(
        table.number("elevation_deg", ANGLE, default_start.elevation_deg),
        table.number("rate_deg_s", RATE, default_start.rate_deg_s),
        table.number("settle_s", PAUSE, default_start.settle_s),
    )


def _built_in_folder() -> Any:
    return resources.files("heli_host.fly") / "plans"
