"""Draw the evidence of a guess: regressions whose slopes give the signs, and errors of each sign choice."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from heli_host.data.arrays import Booleans, Floats, Integers
from heli_host.data.files import save_figure
from heli_host.data.flight import Flight

from heli_lab.setup.guess.result import Guess
from heli_lab.setup.guess.signals import EDGE_S, SAMPLE_STEP_s, Signal, delay, filtered_signal

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_LAG_S = 0.1
"""Delay of the voltages in the figure [s]: a typical rotor lag."""


def draw(guess: Guess, flight: Flight, path: Path) -> Path:
    """Draw the evidence of a guess: one regression per axis, and the errors of each choice of signs."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    figure, panels = plt.subplots(
        1, 4, figsize=(15.5, 3.9), width_ratios=(1, 1, 1, 1.25), layout="constrained"
    )
    for panel, regression in zip(panels[:3], _regressions(flight), strict=True):
        _draw_regression(panel, regression)
    _draw_sign_choices(panels[3], guess)
    if guess.sure:
        verdict = "sure"
    else:
        verdict = f"unsure of {', '.join(ambiguity.subject for ambiguity in guess.ambiguities)}"
    figure.suptitle(f"{flight.meta.get('imported from', 'flight')}: {verdict}", fontsize=11)
    save_figure(figure, path, dpi=110)
    plt.close(figure)
    return path


@dataclass(frozen=True)
class _Regression:
    """Acceleration of an axis, and the signal that drives it."""

    axis: str  # Name of the axis
    cause_label: str  # Name of the signal, with its unit
    cause: Floats  # (n,): The signal
    angle: Signal  # Angle of the axis, low-passed, with its derivatives [rad]
    rows: Integers  # (k,): Rows to draw

    @property
    def points(self) -> tuple[Floats, Floats]:
        """Cause and acceleration [deg/s²], shape (k,) each, after subtracting the parts that deflection and
        rate of the axis explain.
        """
        regressors = np.column_stack((self.angle.value, self.angle.rate, np.ones(self.cause.size)))[self.rows]
        if self.axis == "travel":
            # No torque depends on the travel angle.
            regressors = regressors[:, 1:]
        cause = _without_axis_terms(self.cause[self.rows], regressors)
        acceleration = _without_axis_terms(self.angle.acceleration[self.rows], regressors)
        return cause, np.degrees(acceleration)


def _regressions(flight: Flight) -> list[_Regression]:
    """Prepare the regressions of elevation, pitch and travel for drawing."""
    t_s = np.arange(flight.t_s[0], flight.t_s[-1], SAMPLE_STEP_s)
    elevation, pitch, travel = (
        filtered_signal(np.interp(t_s, flight.t_s, values)) for values in flight.angles_rad.T
    )
    front, back = (
        filtered_signal(np.interp(t_s, flight.t_s, values)).value for values in flight.voltages_V.T
    )
    edge = round(EDGE_S / SAMPLE_STEP_s)
    every_fifth = np.arange(t_s.size)[edge:-edge:5]
    # The voltages do not move an arm that rests on its table.
    in_the_air = _rows_in_the_air(np.interp(t_s, flight.t_s, flight.elevation_rad))
    flying = every_fifth[in_the_air[every_fifth]]
    return [
        _Regression("elevation", "sum of the voltages, V", delay(front + back, _LAG_S), elevation, flying),
        _Regression("pitch", "front less back, V", delay(front - back, _LAG_S), pitch, flying),
        _Regression("travel", "pitch, deg", np.degrees(pitch.value), travel, every_fifth),
    ]


def _draw_regression(panel: Axes, regression: _Regression) -> None:
    """Draw the points of a `regression` and the line through them."""
    cause, acceleration_deg_s2 = regression.points
    panel.plot(cause, acceleration_deg_s2, ".", ms=2.5, alpha=0.5, color="tab:blue")
    if cause.size > 2:
        slope, intercept = np.polyfit(cause, acceleration_deg_s2, 1)
        ends = np.array([cause.min(), cause.max()])
        panel.plot(ends, intercept + slope * ends, color="tab:red")
    panel.set_xlabel(f"{regression.cause_label}, without terms of the axis itself")
    panel.set_ylabel(f"acceleration of {regression.axis}, deg/s²")
    panel.set_title(f"{regression.axis}: the slope must be positive", fontsize=10)
    panel.grid(alpha=0.3)


def _draw_sign_choices(panel: Axes, guess: Guess) -> None:
    """Draw the error of each simulated choice of signs relative to the proposed one; without such choices,
    leave the panel empty.
    """
    if not guess.sign_choices:
        panel.axis("off")
        return
    names = [choice.name or "as proposed" for choice in guess.sign_choices]
    ratios = [choice.error_ratio for choice in guess.sign_choices]
    panel.barh(names[::-1], ratios[::-1], color=["tab:gray"] * (len(names) - 1) + ["tab:blue"])
    panel.axvline(1.0, color="black", lw=0.8)
    panel.set_xscale("log")
    panel.set_xlabel("error of the baseline model, relative")
    panel.set_title("simulated with inverted signs", fontsize=10)


def _without_axis_terms(values: Floats, regressors: Floats) -> Floats:
    """Subtract from a signal the least-squares fit of the `regressors`, shape (n, p); keep the mean."""
    if len(values) < regressors.shape[1]:
        return values
    solution, *_ = np.linalg.lstsq(regressors, values, rcond=None)
    residual: Floats = values - regressors @ solution + values.mean()
    return residual


def _rows_in_the_air(elevation_rad: Floats) -> Booleans:
    """Select the rows in which the arm is well above its lowest elevation, shape (n,)."""
    lowest, typical = float(elevation_rad.min()), float(np.median(elevation_rad))
    # The same share of the rise from the table as in `free_rows`.
    is_in_the_air: Booleans = elevation_rad > lowest + 0.4 * (typical - lowest)
    return is_in_the_air
