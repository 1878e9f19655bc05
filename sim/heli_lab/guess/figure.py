"""Draw the evidence of a guess: regressions whose slopes give the signs, and errors of each sign choice."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from heli_host.arrays import Booleans, Floats
from heli_host.flight import Flight

from heli_lab.guess.regression.signals import delay, filtered_signal
from heli_lab.guess.result import Guess
from heli_lab.guess.thresholds import EDGE_S, SAMPLE_STEP_s

_LAG_S = 0.1
"""Delay of the voltages in the figure [s]: a typical rotor lag."""


def draw(guess: Guess, flight: Flight, path: Path) -> Path:
    """Draw the evidence of a guess into a PNG at `path`; `flight` is the file as the profile reads it."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    t_s = np.arange(flight.t_s[0], flight.t_s[-1], SAMPLE_STEP_s)
    angles = [filtered_signal(np.interp(t_s, flight.t_s, values)) for values in flight.angles_rad.T]
    front, back = (
        filtered_signal(np.interp(t_s, flight.t_s, values)).value for values in flight.voltages_V.T
    )
    edge = round(EDGE_S / SAMPLE_STEP_s)
    # The voltages do not move an arm that rests on its table.
    up = _rows_in_the_air(np.interp(t_s, flight.t_s, flight.elevation_rad))
    rows = slice(edge, -edge, 5)
    pairs = (
        ("sum of the voltages, V", delay(front + back, _LAG_S), angles[0], "elevation", up),
        ("front less back, V", delay(front - back, _LAG_S), angles[1], "pitch", up),
        ("pitch, deg", np.degrees(angles[1].value), angles[2], "travel", np.ones(t_s.size, bool)),
    )
    figure, axes = plt.subplots(1, 4, figsize=(15.5, 3.9), width_ratios=(1, 1, 1, 1.25), layout="constrained")
    for axis, (label, cause, response, name, shown) in zip(axes[:3], pairs, strict=True):
        regressors = np.column_stack((response.value, response.rate, np.ones(t_s.size)))[rows][shown[rows]]
        regressors = regressors[:, 1:] if name == "travel" else regressors
        x = _without_axis_terms(cause[rows][shown[rows]], regressors)
        y = np.degrees(_without_axis_terms(response.acceleration[rows][shown[rows]], regressors))
        axis.plot(x, y, ".", ms=2.5, alpha=0.5, color="tab:blue")
        if x.size > 2:
            slope, level = np.polyfit(x, y, 1)
            ends = np.array([x.min(), x.max()])
            axis.plot(ends, level + slope * ends, color="tab:red")
        axis.set_xlabel(f"{label}, without terms of the axis itself")
        axis.set_ylabel(f"acceleration of {name}, deg/s²")
        axis.set_title(f"{name}: the slope must be positive", fontsize=10)
        axis.grid(alpha=0.3)
    last = axes[3]
    if guess.sign_choices:
        names = [choice.name or "as proposed" for choice in guess.sign_choices]
        ratios = [choice.error_ratio for choice in guess.sign_choices]
        last.barh(names[::-1], ratios[::-1], color=["tab:gray"] * (len(names) - 1) + ["tab:blue"])
        last.axvline(1.0, color="black", lw=0.8)
        last.set_xscale("log")
        last.set_xlabel("error of the baseline model, relative")
        last.set_title("simulated with inverted signs", fontsize=10)
    else:
        last.axis("off")
    verdict = (
        "sure"
        if guess.sure
        else f"unsure of {', '.join(ambiguity.subject for ambiguity in guess.ambiguities)}"
    )
    figure.suptitle(f"{flight.meta.get('imported from', 'flight')}: {verdict}", fontsize=11)
    figure.savefig(path, dpi=110)
    plt.close(figure)
    return path


def _without_axis_terms(values: Floats, regressors: Floats) -> Floats:
    """Subtract what the axis' deflection and rate explain of a signal; its mean stays."""
    if len(values) < regressors.shape[1]:
        return values
    solution, *_ = np.linalg.lstsq(regressors, values, rcond=None)
    rest: Floats = values - regressors @ solution + values.mean()
    return rest


def _rows_in_the_air(elevation_rad: Floats) -> Booleans:
    """Select the rows in which the arm is well above its lowest elevation, shape (n,)."""
    low, typical = float(elevation_rad.min()), float(np.median(elevation_rad))
    up: Booleans = elevation_rad > low + 0.4 * (typical - low)
    return up
