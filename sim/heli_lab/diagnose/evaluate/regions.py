"""Regions of angles, rates and thrusts in which a model fails.

The plane of two quantities is divided into cells. A torque that acts in one cell only is tested as a
regressor of the innovations, with the free parameters projected out. If the model is right, its score in
standard deviations is standard normal. The false discovery rate of all cells is controlled (Benjamini and
Hochberg, J. R. Statist. Soc. B 57, 1995). The method follows "Where Is My Physics Wrong?" (arXiv 2606.23215),
with innovations instead of residuals, because residuals of flights under disturbances are correlated.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from heli_host.arrays import Flags, Floats, Integers
from heli_sim.model.parts import AXES

from heli_lab.diagnose.search import Screening, quantity_values
from heli_lab.diagnose.thresholds import FALSE_DISCOVERY_RATE
from heli_lab.estimation import Estimate, smoothed_disturbances

_CELLS: Final = 8
"""Cells along each quantity: with fewer, regions blur; with more, cells are visited too briefly."""
_VISITED_s: Final = 0.6
"""Time in a cell below which it is not tested: a correlation time of fast disturbances."""
_TAIL: Final = 0.01
"""Share of the flight beyond each end of the cells; it counts into the outermost cells."""
_MOTION: Final = (*AXES, *(f"{axis}_rate" for axis in AXES))
"""Quantities of a plane that a reader can picture: where the arm is and how fast it turns."""
_PLANES: Final = (*_MOTION, "thrust", "thrust_difference")
"""Quantities that a plane may have if a cause is known to depend on them."""


@dataclass(frozen=True)
class PlaneTrajectory:
    """One flight in the plane of the two quantities.

    Parameters
    ----------
    x, y : ndarray (n,)
        The quantities every 40 ms, in SI units.
    torque_Nm : ndarray (n,)
        Torque about the axis that the model lacks, less its mean.
    """

    x: Floats
    y: Floats
    torque_Nm: Floats


@dataclass(frozen=True)
class RegionTest:
    """Tests of all cells for one model.

    Parameters
    ----------
    z : ndarray (cells, cells)
        Score of each cell in standard deviations, x along the first index; nan if the flights were there too
        briefly.
    fails : ndarray of bool (cells, cells)
        Cells in which the model fails.
    share : float
        Share of the flight time in these cells, 0 to 1.
    rms_Nm : float
        Root mean square of the torque about the axis that the model lacks.
    flights : tuple of PlaneTrajectory
        The flights in the plane.
    """

    z: Floats
    fails: Flags
    share: float
    rms_Nm: float
    flights: tuple[PlaneTrajectory, ...]


@dataclass(frozen=True)
class FailingRegions:
    """Regions in which a model fails, before and after it was extended.

    Parameters
    ----------
    axis : str
        Axis of the missing torque.
    x, y : str
        Names of the two quantities of the plane, keys of `QUANTITIES`.
    x_edges, y_edges : ndarray (cells + 1,)
        Edges of the cells, in SI units.
    before, after : RegionTest
        Tests of the model before and after the extension.
    """

    axis: str
    x: str
    y: str
    x_edges: Floats
    y_edges: Floats
    before: RegionTest
    after: RegionTest


def failing_regions(before: Estimate, after: Estimate, axis: str, first: str = "") -> FailingRegions:
    """Find the plane in which the model fails most clearly, and test its cells before and after the
    extension.

    Parameters
    ----------
    before, after : Estimate
        The model before and after the extension, estimated on the same flights.
    axis : str
        Axis of the missing torque.
    first : str, optional
        One of the two quantities, if it is known what the missing torque depends on.
    """
    # Before the extension, disturbances explain what is missing: test against those that remain after it.
    screening = Screening(replace(before, disturbances=after.disturbances))
    values = _values(screening)
    if first not in _PLANES:
        lines = {name: _gain(screening, axis, _cells(values[name]), _CELLS) for name in _MOTION}
        first = max(lines, key=lambda name: lines[name])
    gains = {
        name: _gain(screening, axis, _cells(values[first]) * _CELLS + _cells(values[name]), _CELLS**2)
        for name in _MOTION
        if name != first
    }
    second = max(gains, key=lambda name: gains[name])
    edges = {name: _edges(values[name]) for name in (first, second)}
    then = _test(screening, before, axis, first, second, edges)
    screening.release()
    now = _test(Screening(after), after, axis, first, second, edges)
    return FailingRegions(axis, first, second, edges[first], edges[second], then, now)


def _values(screening: Screening) -> dict[str, Floats]:
    by_flight = [
        quantity_values(linear.model.source, linear.trajectory)
        for linear in screening.filtered.linearised_flights
    ]
    return {name: np.concatenate([values[name] for values in by_flight]) for name in _PLANES}


def _edges(values: Floats) -> Floats:
    low, high = np.quantile(values, [_TAIL, 1.0 - _TAIL])
    return np.linspace(low, max(high, low + 1e-9), _CELLS + 1)


def _cells(values: Floats) -> Integers:
    """Number of the cell of each value, if the cells divide their range."""
    return _number(values, _edges(values))


def _gain(screening: Screening, axis: str, place: Integers, count: int) -> float:
    """Evidence that a model fails in some of `count` cells, `place` being that of each step: mean square of
    their scores less 1, by the root of their number.
    """
    z = _scores(screening, axis, place, count)
    return float(np.nansum(z**2 - 1.0) / np.sqrt(max(1, np.isfinite(z).sum())))


def _number(values: Floats, edges: Floats) -> Integers:
    return np.clip(np.searchsorted(edges, values, side="right") - 1, 0, _CELLS - 1)


def _scores(screening: Screening, axis: str, place: Integers, count: int) -> Floats:
    """Score of a torque in each of `count` cells in standard deviations, `place` being the cell of each step;
    nan if there were too few steps.
    """
    step_s = screening.filtered.linearised_flights[0].trajectory.step_s
    visited = np.nonzero(np.bincount(place, minlength=count) * step_s >= _VISITED_s)[0]
    z = np.full(count, np.nan)
    lengths = np.cumsum([linear.rows for linear in screening.filtered.linearised_flights])[:-1]
    for low in range(0, len(visited), screening.batch):
        cells = visited[low : low + screening.batch]
        inside = np.asarray(place[:, None] == cells[None, :], float)
        regressors = screening.filtered.disturbance_regressors(
            screening.estimate.disturbances, AXES.index(axis), np.split(inside, lengths)
        )
        parts = screening.projected(regressors, [1] * len(cells))
        z[cells] = [gradient[0] / np.sqrt(max(information[0, 0], 1e-12)) for information, gradient in parts]
    return z


def _test(
    screening: Screening, estimate: Estimate, axis: str, x: str, y: str, edges: Mapping[str, Floats]
) -> RegionTest:
    """Test the cells by a screening; the missing torque is smoothed with the estimate's own disturbances."""
    # It takes most of a second to import.
    from scipy.stats import false_discovery_control

    values = _values(screening)
    place = _number(values[x], edges[x]) * _CELLS + _number(values[y], edges[y])
    z = _scores(screening, axis, place, _CELLS**2)
    tested = np.nonzero(np.isfinite(z))[0]
    fails = np.zeros(_CELLS**2, bool)
    # Two-sided p-values of standard normal scores, by the procedure of Benjamini and Hochberg.
    p_values = [math.erfc(abs(score) / math.sqrt(2.0)) for score in z[tested]]
    if p_values:
        fails[tested] = false_discovery_control(p_values) <= FALSE_DISCOVERY_RATE
    smoothed = smoothed_disturbances(screening.filtered, estimate.disturbances)
    trajectories = []
    for linear, (_, torque_Nm, _) in zip(screening.filtered.linearised_flights, smoothed, strict=True):
        rows = np.concatenate([blocks.rows for blocks in linear.blocks])
        at = quantity_values(linear.model.source, linear.trajectory)
        axis_torque_Nm = torque_Nm[:, AXES.index(axis)]
        trajectories.append(PlaneTrajectory(at[x][rows], at[y][rows], axis_torque_Nm - axis_torque_Nm.mean()))
    all_torques_Nm = np.concatenate([trajectory.torque_Nm for trajectory in trajectories])
    return RegionTest(
        z.reshape(_CELLS, _CELLS),
        fails.reshape(_CELLS, _CELLS),
        float(fails[place].mean()),
        float(np.sqrt(np.mean(all_torques_Nm**2))),
        tuple(trajectories),
    )
