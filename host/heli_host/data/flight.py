"""A flight as arrays: the input of every analysis, with its views and the checks that it must pass.

This module imports nothing of ports, boards, sessions or files. Therefore programs that only analyse flights
(identification, reports) may import it alone. `heli_host.data.log` reads and writes flights.

Convention of time: row ``k`` holds the angles read at ``t_s[k]`` and the voltages that act from ``t_s[k]``
until ``t_s[k + 1]``. The board's telemetry has the same order: in one tick it reads the counts, then computes
the voltages that it holds until the next.
"""

from __future__ import annotations

import base64
import html
import io
import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Final, Protocol

import numpy as np
from numpy.typing import NDArray

from heli_host.data.arrays import Floats
from heli_host.declaration import AXES
from heli_host.errors import FlightDataError

if TYPE_CHECKING:
    import pandas


Bytes = NDArray[np.uint8]

ANGLE_COLUMNS = tuple(f"{axis}_rad" for axis in AXES)
REQUIRED_COLUMNS = ("t_s", "front_V", "back_V", *ANGLE_COLUMNS)
"""Columns that a flight cannot do without, in the order in which they are written."""

SETPOINT_COLUMNS = tuple(f"{axis}_setpoint_rad" for axis in AXES)
STATUS_COLUMNS = ("state", "fault", "flags")
OWN_COLUMNS = (*REQUIRED_COLUMNS, *SETPOINT_COLUMNS, *STATUS_COLUMNS)
"""Columns that are attributes of a flight; all others are in its ``extra``."""

MIN_ROWS = 10
"""Fewer rows than this are no flight."""

RATE_WINDOW_S: Final = 0.1
"""Length of the parabolas that a rate is read from [s]. An encoder of 4096 counts per revolution leaves 0.1
deg/s of noise (rms) at 1 kHz, one of 1024 four times as much. A sine of 3 Hz loses 9 % of its rate. Half of
the length would cost 2.8 times the noise.
"""

_MIN_PARABOLA_ROWS = 5
_GAP_RATIO = 1.75
"""Median steps from which on a step is a gap: less than the 2 of a lost row, more than a late row has."""
_MAX_POINTS = 800
"""Points of a line in the small figure, which is 640 dots wide."""
_COLOURS: Final = {"elevation": "#0b5fa5", "pitch": "#b3420f", "travel": "#157a4a"}
_MOTOR_COLOURS: Final = {"front": "#6b3fa0", "back": "#c98a00"}


class Recorded(Protocol):
    """Angles and voltages over time, as samples and flights hold them; arrays of shape (n,)."""

    @property
    def t_s(self) -> Floats:
        """Time [s]."""
        ...

    @property
    def front_V(self) -> Floats:
        """Voltage of the front motor [V]."""
        ...

    @property
    def back_V(self) -> Floats:
        """Voltage of the back motor [V]."""
        ...

    @property
    def elevation_rad(self) -> Floats:
        """Elevation [rad]."""
        ...

    @property
    def pitch_rad(self) -> Floats:
        """Pitch [rad]."""
        ...

    @property
    def travel_rad(self) -> Floats:
        """Travel [rad]."""
        ...

    def columns(self) -> Mapping[str, NDArray[Any]]:
        """Every column by name."""
        ...


class AngleViews:
    """Angles in degrees, their rates, and the whole as a table or a figure, for whatever is `Recorded`."""

    @property
    def elevation_deg(self: Recorded) -> Floats:
        """Elevation [deg], shape (n,)."""
        return np.rad2deg(self.elevation_rad)

    @property
    def pitch_deg(self: Recorded) -> Floats:
        """Pitch [deg], shape (n,)."""
        return np.rad2deg(self.pitch_rad)

    @property
    def travel_deg(self: Recorded) -> Floats:
        """Travel [deg], shape (n,)."""
        return np.rad2deg(self.travel_rad)

    @property
    def elevation_rate_deg_s(self: Recorded) -> Floats:
        """Rate of elevation [deg/s], shape (n,); see `rate`."""
        return np.rad2deg(rate(self.t_s, self.elevation_rad))

    @property
    def pitch_rate_deg_s(self: Recorded) -> Floats:
        """Rate of pitch [deg/s], shape (n,); see `rate`."""
        return np.rad2deg(rate(self.t_s, self.pitch_rad))

    @property
    def travel_rate_deg_s(self: Recorded) -> Floats:
        """Rate of travel [deg/s], shape (n,); see `rate`."""
        return np.rad2deg(rate(self.t_s, self.travel_rad))

    def dataframe(self: Recorded) -> pandas.DataFrame:
        """Return a table of pandas: every column, indexed by ``t_s``, and behind them the angles in degrees
        (``elevation_deg`` ...) and their rates (``elevation_rate_deg_s`` ...).

        Raises
        ------
        ImportError
            If pandas is not installed.
        """
        import pandas

        columns = dict(self.columns())
        t_s = columns.pop("t_s", self.t_s)
        angles_rad = {axis: columns[f"{axis}_rad"] for axis in AXES}
        columns |= {f"{axis}_deg": np.rad2deg(angle) for axis, angle in angles_rad.items()}
        columns |= {
            f"{axis}_rate_deg_s": np.rad2deg(rate(self.t_s, angle)) for axis, angle in angles_rad.items()
        }
        return pandas.DataFrame(columns, index=pandas.Index(t_s, name="t_s"))

    def _repr_html_(self: Recorded) -> str:
        """Return HTML for a notebook: the text of `repr`, and a small figure of angles and voltages."""
        text = f"<p>{html.escape(repr(self))}</p>"
        if self.t_s.size < 2:
            return text
        picture = base64.b64encode(small_figure(self)).decode("ascii")
        return f'{text}<img alt="angles and voltages over time" src="data:image/png;base64,{picture}">'


def rate(t_s: Floats, angle_rad: Floats, window_s: float = RATE_WINDOW_S) -> Floats:
    """Differentiate an encoder's angle: at each time the slope of a parabola fitted to the angles around it.
    Shapes: `t_s` (n,), `angle_rad` (n,); returns (n,).
    """
    from scipy.signal import savgol_filter

    rate_rad_s = np.full(t_s.shape, np.nan)
    if t_s.size < _MIN_PARABOLA_ROWS:
        return rate_rad_s
    step_s = float(np.median(np.diff(t_s)))
    rows = max(_MIN_PARABOLA_ROWS, 2 * round(window_s / step_s / 2) + 1)
    cuts = [0, *(find_gaps(t_s) + 1), t_s.size]
    for start, stop in itertools.pairwise(cuts):
        if stop - start >= _MIN_PARABOLA_ROWS:
            window_rows = min(rows, stop - start - (stop - start + 1) % 2)
            rate_rad_s[start:stop] = savgol_filter(
                angle_rad[start:stop], window_rows, 2, deriv=1, delta=step_s
            )
    return rate_rad_s


def find_gaps(t_s: Floats) -> NDArray[np.intp]:
    """Return the rows of rising times `t_s`, shape (n,), after which time is missing."""
    # Row ``k`` is one when ``t_s[k + 1] - t_s[k]`` exceeds 1.75 median steps.
    if t_s.size < 3:
        return np.zeros(0, np.intp)
    step_s = np.diff(t_s)
    return np.flatnonzero(step_s > _GAP_RATIO * float(np.median(step_s)))


def broken_at_gaps(t_s: Floats, values: Floats) -> tuple[Floats, Floats]:
    """Return times and values with NaN in each gap, so that no line is drawn through missing data. Shapes:
    `t_s` (n,), `values` (n,).
    """
    rows_after_gap = find_gaps(t_s) + 1
    values = np.asarray(values, np.float64)
    return np.insert(t_s, rows_after_gap, np.nan), np.insert(values, rows_after_gap, np.nan, axis=0)


def small_figure(recorded: Recorded) -> bytes:
    """Draw angles [deg] above and voltages [V] below, over time; return a PNG file."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6.4, 3.2), dpi=100, layout="constrained")
    FigureCanvasAgg(figure)  # draws without a window
    angle_panel, volts_panel = figure.subplots(2, 1, sharex=True, height_ratios=(2, 1))
    thinned = slice(None, None, max(1, recorded.t_s.size // _MAX_POINTS))
    t_s = recorded.t_s[thinned]
    columns = recorded.columns()
    for axis, colour in _COLOURS.items():
        setpoint_rad = columns.get(f"{axis}_setpoint_rad")
        if setpoint_rad is not None:
            setpoint_deg = np.rad2deg(setpoint_rad[thinned])
            angle_panel.plot(*broken_at_gaps(t_s, setpoint_deg), color=colour, lw=0.8, ls="--", alpha=0.6)
        angle_deg = np.rad2deg(columns[f"{axis}_rad"][thinned])
        angle_panel.plot(*broken_at_gaps(t_s, angle_deg), color=colour, lw=1.2, label=axis)
    for motor, colour in _MOTOR_COLOURS.items():
        motor_V = columns[f"{motor}_V"][thinned]
        volts_panel.plot(*broken_at_gaps(t_s, motor_V), color=colour, lw=0.9, label=motor)
    for panel, unit in ((angle_panel, "deg"), (volts_panel, "V")):
        panel.set_ylabel(unit)
        panel.grid(alpha=0.25)
        panel.tick_params(labelsize=8)
        panel.legend(fontsize=7, loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False)
    if "travel_setpoint_rad" in columns:
        angle_panel.set_title("dashed: setpoints", fontsize=8, loc="right")
    volts_panel.set_xlabel("time [s]", fontsize=8)
    buffer = io.BytesIO()
    # Without the version of matplotlib, the same flight gives the same bytes.
    figure.savefig(buffer, format="png", metadata={"Software": None})
    return buffer.getvalue()


def shares(state: NDArray[np.uint8], names: Mapping[int, str]) -> str:
    """Return the states and the share of the rows in each, in the order of their first appearance. Shapes:
    `state` (n,).
    """
    numbers, first, counts = np.unique(state, return_index=True, return_counts=True)
    order: Sequence[int] = np.argsort(first).tolist()
    return ", ".join(
        f"{names.get(int(numbers[k]), numbers[k])} {100 * counts[k] / state.size:.0f} %" for k in order
    )


@dataclass(frozen=True)
class FlightEvent:
    """Something that happened in a flight."""

    t_s: float  # When, on the flight's time axis
    name: str  # Kind of event: ``state``, ``fault``, ``setpoint_stale``, ``plan``, ``link`` ..
    text: str  # Description of the event and its cause, in words


@dataclass(frozen=True, repr=False)
class Flight(AngleViews):
    """One flight, evenly sampled, with time first.

    Parameters
    ----------
    t_s : ndarray (n,)
        Time of each row in seconds; strictly rising.
    front_V, back_V : ndarray (n,)
        Motor voltages that act from ``t_s[k]`` until ``t_s[k + 1]``.
    elevation_rad, pitch_rad, travel_rad : ndarray (n,)
        Angles read at ``t_s[k]``. Level is 0; elevation is positive upwards, pitch when the front rotor is
        up, and travel accelerates positive at positive pitch.
    elevation_setpoint_rad, pitch_setpoint_rad, travel_setpoint_rad : ndarray (n,) or None
        Setpoints that the control law used; None when the file has none.
    state, fault, flags : ndarray of uint8 (n,) or None
        The board's supervisor state, fault code and flag bits; None when the file has none.
    state_names, fault_names : Mapping[int, str]
        Names of these numbers, as declared by the board that flew.
    parameters : Mapping[str, float]
        The board's parameters during the flight; empty when unknown.
    plan : str
        Text of the flight plans that were flown; empty when unknown.
    extra : Mapping[str, ndarray (n,)]
        Further columns of a table, or channels of a log, by name.
    meta : Mapping[str, str]
        Where the flight comes from: rig, versions, counters, and the notes of its file.

    Raises
    ------
    FlightDataError
        If the arrays differ in length.
    """

    t_s: Floats
    front_V: Floats
    back_V: Floats
    elevation_rad: Floats
    pitch_rad: Floats
    travel_rad: Floats
    elevation_setpoint_rad: Floats | None = None
    pitch_setpoint_rad: Floats | None = None
    travel_setpoint_rad: Floats | None = None
    state: Bytes | None = None
    fault: Bytes | None = None
    flags: Bytes | None = None
    state_names: Mapping[int, str] = field(default_factory=dict)
    fault_names: Mapping[int, str] = field(default_factory=dict)
    events: tuple[FlightEvent, ...] = ()
    parameters: Mapping[str, float] = field(default_factory=dict)
    plan: str = ""
    extra: Mapping[str, Floats] = field(default_factory=dict)
    meta: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name, column in self.columns().items():
            if column.shape != self.t_s.shape or column.ndim != 1:
                raise FlightDataError(
                    f"column {name} has shape {column.shape}, t_s has {self.t_s.shape}",
                    "give every column one value per row",
                )

    def __len__(self) -> int:
        return int(self.t_s.size)

    def __repr__(self) -> str:
        if not len(self):
            return "<Flight: no rows>"
        rate_Hz = 1.0 / self.step_s if self.step_s else 0.0
        parts = [f"{self.duration_s:.1f} s, {len(self)} rows at {rate_Hz:.4g} Hz"]
        parts += [f"{len(self.gaps)} gaps"] if len(self.gaps) else []
        parts += [f"rig {self.meta['rig']}"] if self.meta.get("rig") else []
        parts += [shares(self.state, self.state_names)] if self.state is not None else []
        return f"<Flight: {'; '.join(parts)}>"

    @property
    def duration_s(self) -> float:
        """Time from the first row to the last, in seconds."""
        return float(self.t_s[-1] - self.t_s[0]) if len(self) else 0.0

    @property
    def step_s(self) -> float:
        """Time from one row to the next (median), in seconds."""
        return float(np.median(np.diff(self.t_s))) if len(self) > 1 else 0.0

    @property
    def angles_rad(self) -> Floats:
        """Elevation, pitch and travel side by side, shape (n, axes)."""
        return np.column_stack([getattr(self, name) for name in ANGLE_COLUMNS])

    @property
    def setpoints_rad(self) -> Floats | None:
        """Setpoints side by side as in `angles_rad`, shape (n, axes); None when there are none."""
        columns = [getattr(self, name) for name in SETPOINT_COLUMNS]
        known = [column for column in columns if column is not None]
        return np.column_stack(known) if len(known) == len(columns) else None

    @property
    def voltages_V(self) -> Floats:
        """Front and back voltage side by side, shape (n, 2)."""
        return np.column_stack((self.front_V, self.back_V))

    @property
    def gaps(self) -> NDArray[np.intp]:
        """Rows after which time is missing, shape (g,); empty for a flight without losses."""
        return find_gaps(self.t_s)

    def columns(self) -> dict[str, NDArray[Any]]:
        """Return every column that the flight has, by name, required ones first."""
        named: dict[str, NDArray[Any]] = {name: getattr(self, name) for name in REQUIRED_COLUMNS}
        for name in SETPOINT_COLUMNS + STATUS_COLUMNS:
            column = getattr(self, name)
            if column is not None:
                named[name] = column
        named.update(self.extra)
        return named

    def between(self, start_s: float, stop_s: float) -> Flight:
        """Cut out the rows with ``start_s <= t_s < stop_s`` and the events among them, for example without
        take-off and landing.

        Parameters
        ----------
        start_s, stop_s : float
            First time kept and first time no longer kept, on this flight's axis; the axis itself does not
            change.

        Raises
        ------
        FlightDataError
            If fewer rows than a flight needs are left.
        """
        keep = (self.t_s >= start_s) & (self.t_s < stop_s)
        kept_rows = int(keep.sum())
        if kept_rows < MIN_ROWS:
            raise FlightDataError(
                f"only {kept_rows} rows between {start_s:g} and {stop_s:g} s",
                f"this flight spans {self.t_s[0]:g} to {self.t_s[-1]:g} s"
                if len(self)
                else "the flight is empty",
            )
        attributes: dict[str, Any] = {
            name: column[keep] for name, column in self.columns().items() if name in OWN_COLUMNS
        }
        return replace(
            self,
            **attributes,
            extra={name: column[keep] for name, column in self.extra.items()},
            events=tuple(event for event in self.events if start_s <= event.t_s < stop_s),
        )


MAX_ANGLE_RAD: Final = {"elevation_rad": 1.6, "pitch_rad": 3.2}
"""Largest possible angles: the arm cannot pass the vertical, and the short arm cannot turn over."""
_MAX_COUNT_RAD = 0.02
"""Largest plausible step of an encoder: 314 counts per turn. In degrees, even 16384 counts step by 0.022."""
_MIN_MOVES = 20
_MAX_RATE_RAD_S = 20.0
"""Over a tenth of a second, in one row of a hundred; the board's own limits are below 10."""
MAX_VOLTAGE_V = 100.0
_MIN_ROWS_JOINED = 100
"""Rows before and after a fall of time from which it counts as the begin of another flight. Fewer: a single
bad time is taken for one. More: short flights that were joined are not recognised."""
_NEW_START_SHARE = 0.5
"""Share of the time that has passed, below which a time that falls is the start of another flight."""
_MAX_STEP_S = 0.5
"""Longest typical step [s]: a row every millisecond, in milliseconds, steps by 1."""


def data_row(row: int) -> str:
    """Name a `row`, counted from 0, in a message."""
    return f"data row {row + 1}"


def check_flight(
    flight: Flight, source: str, *, allow_gaps: bool = False, where: Callable[[int], str] = data_row
) -> None:
    """Refuse a flight that no analysis could trust."""
    if len(flight) < MIN_ROWS:
        raise FlightDataError(
            f"{source}: t_s has only {len(flight)} rows", f"record a flight of at least {MIN_ROWS} rows"
        )
    for name, column in flight.columns().items():
        if name in flight.extra or column.dtype.kind != "f":
            continue
        bad_rows = np.flatnonzero(~np.isfinite(column))
        if bad_rows.size:
            raise FlightDataError(
                f"{source}: {name} is {column[bad_rows[0]]} in {where(int(bad_rows[0]))} "
                f"({bad_rows.size} such rows)",
                "remove these rows, or the part of the flight around them",
            )
    # Differences of huge numbers overflow to infinity; the checks then refuse them as too large.
    with np.errstate(over="ignore", invalid="ignore"):
        _check_time(flight.t_s, source, allow_gaps, where)
        _check_units(flight, source, where)


def _check_time(t_s: Floats, source: str, allow_gaps: bool, where: Callable[[int], str]) -> None:
    """Refuse times that do not increase, are in another unit than seconds, or have gaps. `where` names a row
    of the file.
    """
    step_s = np.diff(t_s)
    steps_not_rising = np.flatnonzero(step_s <= 0.0)
    if steps_not_rising.size:
        row = int(steps_not_rising[0]) + 1
        rows_before, rows_after = row, len(t_s) - row
        # The time of another flight starts anew; rows out of order step back by little.
        is_new_start = t_s[row] - t_s[0] < _NEW_START_SHARE * (t_s[row - 1] - t_s[0])
        are_both_flights = min(rows_before, rows_after) >= _MIN_ROWS_JOINED
        if len(steps_not_rising) == 1 and is_new_start and are_both_flights:
            raise FlightDataError(
                f"{source} holds two flights that were joined: t_s falls from {t_s[row - 1]:.9g} to "
                f"{t_s[row]:.9g} s in {where(row)}",
                "give each flight as a file of its own",
            )
        raise FlightDataError(
            f"{source}: t_s does not increase in {where(row)}: {t_s[row]:.9g} after {t_s[row - 1]:.9g} s",
            "sort the rows by time, and remove duplicates",
        )
    typical_s = float(np.median(step_s))
    if typical_s > _MAX_STEP_S:
        raise FlightDataError(
            f"{source}: t_s increases by {typical_s:g} per row, as in {where(1)}, which looks like "
            "milliseconds or samples",
            "give t_s in seconds",
        )
    gaps = find_gaps(t_s)
    if gaps.size and not allow_gaps:
        row = int(gaps[0]) + 1
        raise FlightDataError(
            f"{source}: t_s jumps by {step_s[row - 1]:.6g} s in {where(row)}, a step is "
            f"{typical_s:.6g} s ({gaps.size} gaps)",
            "cut the flight there, or skip the missing rows by --allow-gaps (in Python allow_gaps=True)",
        )


_TURNING_SHARE: Final = 0.9
"""Share of the rows in which an angle moves in one direction, from which on its arm turns on and on."""


def _check_units(flight: Flight, source: str, where: Callable[[int], str]) -> None:
    """Refuse angles that are probably in degrees, by their size, rate or encoder step, and voltages that are
    probably not in volts. `where` names a row of the file.
    """
    suspicion, remedy = "looks like degrees", "multiply the angles by pi/180"
    for name, max_angle_rad in MAX_ANGLE_RAD.items():
        column = getattr(flight, name)
        row = int(np.argmax(np.abs(column)))
        if abs(column[row]) > max_angle_rad:
            raise FlightDataError(
                f"{source}: {name} is {column[row]:.4g} in {where(row)}, which {suspicion}", remedy
            )
        row, rate_rad_s = _rate_exceeded_by_1_percent(column, flight.step_s)
        if rate_rad_s > _MAX_RATE_RAD_S:
            raise FlightDataError(
                f"{source}: {name} moves by {rate_rad_s:.3g} per second in {where(row)}, which {suspicion}",
                remedy,
            )
    for name in (f"{axis}_rad" for axis in AXES):
        moves = np.diff(getattr(flight, name))
        # An arm that turns on and on moves by many counts from row to row of a slow log.
        if abs(float(np.sign(moves).mean())) > _TURNING_SHARE:
            continue
        moving_rows = np.flatnonzero(moves)
        if moving_rows.size < _MIN_MOVES:
            continue
        # The smallest move is a count of the encoder.
        count = float(np.abs(moves[moving_rows]).min())
        if count > _MAX_COUNT_RAD:
            raise FlightDataError(
                f"{source}: {name} moves in steps of {count:.4g} (the first in "
                f"{where(int(moving_rows[0]) + 1)}), which {suspicion}",
                remedy,
            )
    for name in ("front_V", "back_V"):
        column = getattr(flight, name)
        row = int(np.argmax(np.abs(column)))
        if abs(column[row]) > MAX_VOLTAGE_V:
            raise FlightDataError(
                f"{source}: {name} is {column[row]:.4g} in {where(row)}, which looks like millivolts or a "
                "duty",
                "give volts",
            )


def _rate_exceeded_by_1_percent(angle_rad: Floats, step_s: float) -> tuple[int, float]:
    """Return the rate over 0.1 s that only one row in a hundred exceeds, and a row with this rate."""
    reach = max(1, round(0.1 / step_s))
    if angle_rad.size <= reach:
        return 0, 0.0
    rates = np.abs(angle_rad[reach:] - angle_rad[:-reach]) / (reach * step_s)
    rank = int(0.99 * (rates.size - 1))
    row = int(np.argpartition(rates, rank)[rank])
    return row, float(rates[row])
