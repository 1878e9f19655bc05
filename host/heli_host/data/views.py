"""Views of recorded angles: degrees, rates, a pandas table, and a small figure in a notebook."""

from __future__ import annotations

import base64
import html
import io
import itertools
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final, Protocol

import numpy as np
from numpy.typing import NDArray

from heli_host.arrays import Floats
from heli_host.declaration import AXES

if TYPE_CHECKING:
    import pandas


RATE_WINDOW_S: Final = 0.1
"""Length of the parabolas that a rate is read from [s]. An encoder of 4096 counts per revolution leaves 0.1
deg/s of noise (rms) at 1 kHz, one of 1024 four times as much. A sine of 3 Hz loses 9 % of its rate. Half of
the length would cost 2.8 times the noise.
"""

_MIN_ROWS = 5
_GAP_RATIO = 1.75
_MAX_POINTS = 800
"""Points of a line in the small figure, which is 640 dots wide."""
_COLOURS: Final = {"elevation": "#0b5fa5", "pitch": "#b3420f", "travel": "#157a4a"}


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
    if t_s.size < _MIN_ROWS:
        return rate_rad_s
    step_s = float(np.median(np.diff(t_s)))
    rows = max(_MIN_ROWS, 2 * round(window_s / step_s / 2) + 1)
    cuts = [0, *(find_gaps(t_s) + 1), t_s.size]
    for start, stop in itertools.pairwise(cuts):
        if stop - start >= _MIN_ROWS:
            window_rows = min(rows, stop - start - (stop - start + 1) % 2)
            rate_rad_s[start:stop] = savgol_filter(
                angle_rad[start:stop], window_rows, 2, deriv=1, delta=step_s
            )
    return rate_rad_s


def find_gaps(t_s: Floats) -> NDArray[np.intp]:
    """Return the rows of rising times `t_s`, shape (n,), after which time is missing.

    Row ``k`` is one when ``t_s[k + 1] - t_s[k]`` exceeds 1.75 median steps.
    """
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


def small_figure(of: Recorded) -> bytes:
    """Draw angles [deg] above and voltages [V] below, over time."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6.4, 3.2), dpi=100, layout="constrained")
    FigureCanvasAgg(figure)
    angles, volts = figure.subplots(2, 1, sharex=True, height_ratios=(2, 1))
    step = max(1, of.t_s.size // _MAX_POINTS)
    t_s = of.t_s[::step]
    columns = of.columns()
    for axis, colour in _COLOURS.items():
        setpoint_rad = columns.get(f"{axis}_setpoint_rad")
        if setpoint_rad is not None:
            setpoint_deg = np.rad2deg(setpoint_rad[::step])
            angles.plot(*broken_at_gaps(t_s, setpoint_deg), color=colour, lw=0.8, ls="--", alpha=0.6)
        angle_deg = np.rad2deg(columns[f"{axis}_rad"][::step])
        angles.plot(*broken_at_gaps(t_s, angle_deg), color=colour, lw=1.2, label=axis)
    volts.plot(*broken_at_gaps(t_s, of.front_V[::step]), color="#6b3fa0", lw=0.9, label="front")
    volts.plot(*broken_at_gaps(t_s, of.back_V[::step]), color="#c98a00", lw=0.9, label="back")
    for axes, unit in ((angles, "deg"), (volts, "V")):
        axes.set_ylabel(unit)
        axes.grid(alpha=0.25)
        axes.tick_params(labelsize=8)
        axes.legend(fontsize=7, loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False)
    if "travel_setpoint_rad" in columns:
        angles.set_title("dashed: setpoints", fontsize=8, loc="right")
    volts.set_xlabel("time [s]", fontsize=8)
    buffer = io.BytesIO()
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
