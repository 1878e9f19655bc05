"""What a guess rests on, drawn: the answers whose slopes are the signs, and every choice flown."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from heli_host.arrays import Floats
from heli_host.flight import Flight
from numpy.typing import NDArray

from heli_lab.guess.result import Guess
from heli_lab.guess.signals import filtered_signal, late
from heli_lab.guess.thresholds import EDGE_S, STEP_S

_LAG_S = 0.1
"""Voltages are drawn this late: what rotors usually take."""


def draw(guess: Guess, flight: Flight, path: Path) -> Path:
    """Draw a guess on the `flight` that its profile makes of the file, into a PNG at `path`."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    t_s = np.arange(flight.t_s[0], flight.t_s[-1], STEP_S)
    angles = [filtered_signal(np.interp(t_s, flight.t_s, values)) for values in flight.angles_rad.T]
    front, back = (
        filtered_signal(np.interp(t_s, flight.t_s, values)).value for values in flight.voltages_V.T
    )
    edge = round(EDGE_S / STEP_S)
    # On the table the voltages move nothing.
    up = _up(np.interp(t_s, flight.t_s, flight.elevation_rad))
    rows = slice(edge, -edge, 5)
    pairs = (
        ("sum of the voltages, V", late(front + back, _LAG_S), angles[0], "elevation", up),
        ("front less back, V", late(front - back, _LAG_S), angles[1], "pitch", up),
        ("pitch, deg", np.degrees(angles[1].value), angles[2], "travel", np.ones(t_s.size, bool)),
    )
    figure, axes = plt.subplots(1, 4, figsize=(15.5, 3.9), width_ratios=(1, 1, 1, 1.25), layout="constrained")
    for axis, (label, cause, answer, name, seen) in zip(axes[:3], pairs, strict=True):
        regressors = np.column_stack((answer.value, answer.rate, np.ones(t_s.size)))[rows][seen[rows]]
        regressors = regressors[:, 1:] if name == "travel" else regressors
        x = _beside(cause[rows][seen[rows]], regressors)
        y = np.degrees(_beside(answer.acceleration[rows][seen[rows]], regressors))
        axis.plot(x, y, ".", ms=2.5, alpha=0.5, color="tab:blue")
        if x.size > 2:
            slope, level = np.polyfit(x, y, 1)
            ends = np.array([x.min(), x.max()])
            axis.plot(ends, level + slope * ends, color="tab:red")
        axis.set_xlabel(f"{label}, beside its own motion")
        axis.set_ylabel(f"acceleration of {name}, deg/s²")
        axis.set_title(f"{name} must rise with it", fontsize=10)
        axis.grid(alpha=0.3)
    last = axes[3]
    if guess.choices:
        names = [choice.name or "as proposed" for choice in guess.choices]
        ratios = [choice.ratio for choice in guess.choices]
        last.barh(names[::-1], ratios[::-1], color=["tab:gray"] * (len(names) - 1) + ["tab:blue"])
        last.axvline(1.0, color="black", lw=0.8)
        last.set_xscale("log")
        last.set_xlabel("error of the baseline model, relative")
        last.set_title("signs turned round, flown", fontsize=10)
    else:
        last.axis("off")
    verdict = "sure" if guess.sure else f"unsure of {', '.join(doubt.what for doubt in guess.doubts)}"
    figure.suptitle(f"{flight.meta.get('imported from', 'flight')}: {verdict}", fontsize=11)
    figure.savefig(path, dpi=110)
    plt.close(figure)
    return path


def _beside(values: Floats, regressors: Floats) -> Floats:
    """What the axis' own deflection and rate leave of a signal, about its mean."""
    if len(values) < regressors.shape[1]:
        return values
    solution, *_ = np.linalg.lstsq(regressors, values, rcond=None)
    rest: Floats = values - regressors @ solution + values.mean()
    return rest


def _up(elevation_rad: Floats) -> NDArray[np.bool_]:
    """Rows in which the arm is well above where it is lowest, shape (n,)."""
    low, usual = float(elevation_rad.min()), float(np.median(elevation_rad))
    up: NDArray[np.bool_] = elevation_rad > low + 0.4 * (usual - low)
    return up
