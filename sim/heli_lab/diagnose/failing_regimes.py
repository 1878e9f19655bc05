"""Where a model fails: the regimes of angles, rates and thrusts in which something is missing.

The plane of two quantities is divided into cells. A torque that acts in one cell alone is scored as a
regressor of the innovations, the free parameters projected out: its score in standard deviations is normal
where the model is right. Cells are then taken together so that among those that are said to fail a set share
at most is said so by chance (false discovery rate, Benjamini and Hochberg, J. R. Statist. Soc. B 57, 1995).
After "Where Is My Physics Wrong?" (arXiv 2606.23215), with innovations in the place of residuals: there
errors are independent, here they are weather.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from heli_host.arrays import Floats
from heli_sim.model.parts import AXES

from heli_lab.diagnose.screening import Screening
from heli_lab.diagnose.spline_term import QUANTITIES, quantity_values
from heli_lab.diagnose.thresholds import FALSE_DISCOVERY_RATE
from heli_lab.estimation import Estimate

if TYPE_CHECKING:
    import numpy.typing as npt

    Booleans = npt.NDArray[np.bool_]

_CELLS: Final = 8
"""Cells along each quantity. By judgement: fewer blur the regime, more are visited too briefly to tell."""
_VISITED_s: Final = 0.6
"""Time in a cell, s, below which it tells nothing: the memory of gusts, by judgement."""
_TAIL: Final = 0.01
"""Share of the flight beyond each end of the cells, counted into the last ones."""
_MOTION: Final = (*AXES, *(f"{axis}_rate" for axis in AXES))
"""Quantities that a plane may have: a person knows where the arm is and how fast it turns."""
_PLANES: Final = (*_MOTION, "thrust", "thrust_difference")
"""The same, and what a plane has where it is known to matter."""


@dataclass(frozen=True)
class Moments:
    """A flight in the plane.

    Parameters
    ----------
    x, y : ndarray (n,)
        The quantities every 40 ms.
    torque_Nm : ndarray (n,)
        What the model lacks about the axis, about its mean.
    """

    x: Floats
    y: Floats
    torque_Nm: Floats


@dataclass(frozen=True)
class Regimes:
    """Cells of the plane, tested.

    Parameters
    ----------
    z : ndarray (cells, cells)
        Score of each cell in standard deviations; nan where the flights were too briefly. The first index is
        that of x.
    fails : ndarray of bool (cells, cells)
        Cells that are said to fail.
    share : float
        Share of the flights' time spent in those.
    rms_Nm : float
        What the model lacks about the axis, root mean square.
    moments : tuple of Moments
        Each flight.
    """

    z: Floats
    fails: Booleans
    share: float
    rms_Nm: float
    moments: tuple[Moments, ...]


@dataclass(frozen=True)
class FailingRegimes:
    """Where a model fails, before and after it was extended.

    Parameters
    ----------
    axis : str
        Axis about which the missing torque is looked at.
    x, y : str
        The two quantities that matter most.
    x_edges, y_edges : ndarray (cells + 1,)
        Edges of the cells, in SI units.
    before, after : Regimes
        Of the refitted baseline, and of the model with causes and proposed law.
    """

    axis: str
    x: str
    y: str
    x_edges: Floats
    y_edges: Floats
    before: Regimes
    after: Regimes

    def to_json(self) -> dict[str, Any]:
        """The regimes for other programs."""
        return {
            "axis": self.axis,
            "x": self.x,
            "y": self.y,
            "units": [QUANTITIES[self.x][1], QUANTITIES[self.y][1]],
            "false_discovery_rate": FALSE_DISCOVERY_RATE,
            **{
                name: {
                    "share_of_time": regimes.share,
                    "missing_torque_rms_Nm": regimes.rms_Nm,
                    "cells": [
                        {
                            "x": [float(self.x_edges[i]), float(self.x_edges[i + 1])],
                            "y": [float(self.y_edges[j]), float(self.y_edges[j + 1])],
                            "standard_deviations": float(regimes.z[i, j]),
                        }
                        for i, j in zip(*np.nonzero(regimes.fails), strict=True)
                    ],
                }
                for name, regimes in (("before", self.before), ("after", self.after))
            },
        }


def failing_regimes(before: Estimate, after: Estimate, axis: str, first: str = "") -> FailingRegimes:
    """Find the plane in which the model fails most plainly before, and where it fails before and after.

    Parameters
    ----------
    before, after : Estimate
        The model before and after it was extended, estimated on the same flights.
    axis : str
        Axis about which to look.
    first : str, optional
        One of the two quantities, where it is known what matters.
    """
    # What is missing passes for weather before: it is tested against the weather that remains in the end.
    screening = Screening(replace(before, disturbances=after.disturbances))
    values = _values(screening)
    if first not in _PLANES:
        lines = {name: _gain(screening, axis, [_cell(values[name]), None]) for name in _MOTION}
        first = max(lines, key=lambda name: lines[name])
    gains = {
        name: _gain(screening, axis, [_cell(values[first]), _cell(values[name])])
        for name in _MOTION
        if name != first
    }
    second = max(gains, key=lambda name: gains[name])
    edges = {name: _edges(values[name]) for name in (first, second)}
    then = _regimes(screening, before, axis, first, second, edges)
    screening.release()
    now = _regimes(Screening(after), after, axis, first, second, edges)
    return FailingRegimes(axis, first, second, edges[first], edges[second], then, now)


def _values(screening: Screening) -> dict[str, Floats]:
    every = [
        quantity_values(linear.model.source, linear.trajectory)
        for linear in screening.filtered.linearised_flights
    ]
    return {name: np.concatenate([values[name] for values in every]) for name in _PLANES}


def _edges(values: Floats) -> Floats:
    low, high = np.quantile(values, [_TAIL, 1.0 - _TAIL])
    return np.linspace(low, max(high, low + 1e-9), _CELLS + 1)


def _cell(values: Floats) -> tuple[Floats, Floats]:
    return values, _edges(values)


def _gain(screening: Screening, axis: str, by: list[tuple[Floats, Floats] | None]) -> float:
    """How plainly cells tell where a model fails: mean square of their scores less 1, times their number."""
    first, second = by
    assert first is not None
    place = _number(*first)
    if second is not None:
        place = place * _CELLS + _number(*second)
    z = _scores(screening, axis, place, _CELLS if second is None else _CELLS**2)
    return float(np.nansum(z**2 - 1.0) / np.sqrt(max(1, np.isfinite(z).sum())))


def _number(values: Floats, edges: Floats) -> npt.NDArray[np.int64]:
    return np.clip(np.searchsorted(edges, values, side="right") - 1, 0, _CELLS - 1)


def _scores(screening: Screening, axis: str, place: npt.NDArray[np.int64], count: int) -> Floats:
    """Score of a torque in each of `count` cells in standard deviations, by the cell that each step is in;
    nan where there were too few steps.
    """
    step_s = screening.filtered.linearised_flights[0].trajectory.step_s
    visited = np.nonzero(np.bincount(place, minlength=count) * step_s >= _VISITED_s)[0]
    z = np.full(count, np.nan)
    lengths = np.cumsum([linear.rows for linear in screening.filtered.linearised_flights])[:-1]
    for low in range(0, len(visited), screening.batch):
        some = visited[low : low + screening.batch]
        inside = np.asarray(place[:, None] == some[None, :], float)
        only = screening.filtered.disturbance_regressors(
            screening.estimate.disturbances, AXES.index(axis), np.split(inside, lengths)
        )
        parts = screening.projected(only, [1] * len(some))
        z[some] = [gradient[0] / np.sqrt(max(information[0, 0], 1e-12)) for information, gradient in parts]
    return z


def _regimes(
    screening: Screening, estimate: Estimate, axis: str, x: str, y: str, edges: Mapping[str, Floats]
) -> Regimes:
    """Test the cells by a screening; what the model lacks there comes from its own estimate."""
    # It takes most of a second to import.
    from scipy.stats import false_discovery_control

    values = _values(screening)
    place = _number(values[x], edges[x]) * _CELLS + _number(values[y], edges[y])
    z = _scores(screening, axis, place, _CELLS**2)
    tested = np.nonzero(np.isfinite(z))[0]
    fails = np.zeros(_CELLS**2, bool)
    # Two-sided p-values of standard normal scores; by the procedure of Benjamini and Hochberg.
    p_values = [math.erfc(abs(score) / math.sqrt(2.0)) for score in z[tested]]
    if p_values:
        fails[tested] = false_discovery_control(p_values) <= FALSE_DISCOVERY_RATE
    smoothed = screening.filtered.smoothed_disturbances(estimate.disturbances, np.zeros(len(estimate.theta)))
    moments = []
    for linear, (_, torque_Nm, _) in zip(screening.filtered.linearised_flights, smoothed, strict=True):
        rows = np.concatenate([blocks.rows for blocks in linear.blocks])
        at = quantity_values(linear.model.source, linear.trajectory)
        axis_torque_Nm = torque_Nm[:, AXES.index(axis)]
        moments.append(Moments(at[x][rows], at[y][rows], axis_torque_Nm - axis_torque_Nm.mean()))
    every = np.concatenate([moment.torque_Nm for moment in moments])
    return Regimes(
        z.reshape(_CELLS, _CELLS),
        fails.reshape(_CELLS, _CELLS),
        float(fails[place].mean()),
        float(np.sqrt(np.mean(every**2))),
        tuple(moments),
    )
