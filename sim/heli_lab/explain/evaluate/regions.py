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
from heli_host.data.arrays import Booleans, Floats, Integers
from heli_sim.model.parts import AXES

from heli_lab.explain.search.screening import Screening
from heli_lab.explain.search.splines import quantity_values
from heli_lab.explain.thresholds import FALSE_DISCOVERY_RATE
from heli_lab.fit.estimator import Estimate
from heli_lab.fit.innovations import smoothed_disturbances

_CELLS: Final = 8
"""Cells along each quantity: with fewer, regions blur; with more, cells are visited too briefly."""
_VISITED_s: Final = 0.6
"""Time in a cell below which it is not tested: a correlation time of fast disturbances."""
_TAIL_SHARE: Final = 0.01
"""Share of the flight beyond each end of the cells; it counts into the outermost cells."""
_MOTION: Final = (*AXES, *(f"{axis}_rate" for axis in AXES))
"""Quantities of a plane that a reader can picture: where the arm is and how fast it turns."""
_PLANES: Final = (*_MOTION, "thrust", "thrust_difference")
"""Quantities that a plane may have if a cause is known to depend on them."""


@dataclass(frozen=True)
class PlaneTrajectory:
    """One flight in the plane of the two quantities."""

    x: Floats  # x, y: (n,): The quantities every 40 ms, in SI units
    y: Floats
    torque_Nm: Floats  # (n,): Torque about the axis that the model lacks, less its mean


@dataclass(frozen=True)
class RegionTest:
    """Tests of all cells for one model."""

    z: Floats
    """(cells, cells): Score of each cell in standard deviations, x along the first index; nan if the flights
    were there too briefly."""
    fails: Booleans  # (cells, cells): Cells in which the model fails
    share: float  # Share of the flight time in these cells, 0 to 1
    rms_Nm: float  # Root mean square of the torque about the axis that the model lacks
    flights: tuple[PlaneTrajectory, ...]  # The flights in the plane


@dataclass(frozen=True)
class FailingRegions:
    """Regions in which a model fails, before and after it was extended."""

    axis: str  # Axis of the missing torque
    x: str  # x, y: Names of the two quantities of the plane, keys of `QUANTITIES`
    y: str
    x_edges: Floats  # x_edges, y_edges: (cells + 1,): Edges of the cells, in SI units
    y_edges: Floats
    before: RegionTest  # before, after: Tests of the model before and after the extension
    after: RegionTest


def failing_regions(before: Estimate, after: Estimate, axis: str, first: str = "") -> FailingRegions:
    """Find the plane in which the model fails most clearly, and test its cells before and after the
    extension.
    """
    # Before the extension, disturbances explain what is missing: test against those that remain after it.
    screening = Screening(replace(before, disturbances=after.disturbances))
    values = _plane_values(screening)
    if first not in _PLANES:
        line_evidence = {
            name: _evidence(screening, axis, _cells_along(values[name]), _CELLS) for name in _MOTION
        }
        first = max(line_evidence, key=lambda name: line_evidence[name])
    plane_evidence = {}
    for name in _MOTION:
        if name != first:
            cells = _cells_along(values[first]) * _CELLS + _cells_along(values[name])
            plane_evidence[name] = _evidence(screening, axis, cells, _CELLS**2)
    second = max(plane_evidence, key=lambda name: plane_evidence[name])
    edges = {name: _cell_edges(values[name]) for name in (first, second)}
    test_before = _test_cells(screening, before, axis, first, second, edges)
    screening.release()
    test_after = _test_cells(Screening(after), after, axis, first, second, edges)
    return FailingRegions(
        axis,
        x=first,
        y=second,
        x_edges=edges[first],
        y_edges=edges[second],
        before=test_before,
        after=test_after,
    )


def _plane_values(screening: Screening) -> dict[str, Floats]:
    """Return the quantities of `_PLANES` at all steps of all flights, shape (n,), by name."""
    values_by_flight = [
        quantity_values(linear.model.source, linear.trajectory)
        for linear in screening.filtered.linearised_flights
    ]
    return {name: np.concatenate([values[name] for values in values_by_flight]) for name in _PLANES}


def _cell_edges(values: Floats) -> Floats:
    """Return the edges of the cells along a quantity, shape (cells + 1,)."""
    low, high = np.quantile(values, [_TAIL_SHARE, 1.0 - _TAIL_SHARE])
    return np.linspace(low, max(high, low + 1e-9), _CELLS + 1)


def _cells_along(values: Floats) -> Integers:
    """Divide the range of a quantity into cells, and return the cell number of each value, shape (n,)."""
    return _cell_number(values, _cell_edges(values))


def _evidence(screening: Screening, axis: str, cell: Integers, count: int) -> float:
    """Return the evidence that a model fails in some of `count` cells; `cell` is that of each step, (n,).

    The sum of z^2 - 1 over all cells has the mean 0 if the model is right. It is divided by the root of the
    number of visited cells, so that planes with different numbers can be compared.
    """
    score = _cell_scores(screening, axis, cell, count)
    return float(np.nansum(score**2 - 1.0) / np.sqrt(max(1, np.isfinite(score).sum())))


def _cell_number(values: Floats, edges: Floats) -> Integers:
    """Return the number, 0 to `_CELLS` - 1, of the cell between `edges` of each value, shape (n,)."""
    return np.clip(np.searchsorted(edges, values, side="right") - 1, 0, _CELLS - 1)


def _cell_scores(screening: Screening, axis: str, cell: Integers, count: int) -> Floats:
    """Return the score of a torque in each of `count` cells in standard deviations, shape (count,).

    `cell` is the cell of each step, (n,). The score is nan if the flights were in the cell too briefly.
    """
    step_s = screening.filtered.linearised_flights[0].trajectory.step_s
    visited = np.nonzero(np.bincount(cell, minlength=count) * step_s >= _VISITED_s)[0]
    z = np.full(count, np.nan)
    flight_ends = np.cumsum([linear.rows for linear in screening.filtered.linearised_flights])[:-1]
    for first in range(0, len(visited), screening.batch):
        batch = visited[first : first + screening.batch]
        is_inside = np.asarray(cell[:, None] == batch[None, :], float)
        regressors = screening.filtered.disturbance_regressors(
            screening.estimate.disturbances, AXES.index(axis), np.split(is_inside, flight_ends)
        )
        statistics = screening.projected(regressors, [1] * len(batch))
        z[batch] = [score[0] / np.sqrt(max(information[0, 0], 1e-12)) for information, score in statistics]
    return z


def _test_cells(
    screening: Screening, estimate: Estimate, axis: str, x: str, y: str, edges: Mapping[str, Floats]
) -> RegionTest:
    """Test all cells of a plane about an estimate, with the false discovery rate controlled.

    `screening` gives the scores; the missing torque is smoothed with the disturbances of `estimate`.
    """
    values = _plane_values(screening)
    cell = _cell_number(values[x], edges[x]) * _CELLS + _cell_number(values[y], edges[y])
    z = _cell_scores(screening, axis, cell, _CELLS**2)
    tested = np.nonzero(np.isfinite(z))[0]
    fails = np.zeros(_CELLS**2, bool)
    # Two-sided p-values of standard normal scores.
    p_values = np.array([math.erfc(abs(score) / math.sqrt(2.0)) for score in z[tested]])
    fails[tested] = adjusted_p_values(p_values) <= FALSE_DISCOVERY_RATE
    trajectories = _plane_trajectories(screening, estimate, axis, x, y)
    missing_Nm = np.concatenate([trajectory.torque_Nm for trajectory in trajectories])
    return RegionTest(
        z=z.reshape(_CELLS, _CELLS),
        fails=fails.reshape(_CELLS, _CELLS),
        share=float(fails[cell].mean()),
        rms_Nm=float(np.sqrt(np.mean(missing_Nm**2))),
        flights=trajectories,
    )


def adjusted_p_values(p_values: Floats) -> Floats:
    """Adjust p-values so that a limit on them controls the false discovery rate (Benjamini and Hochberg).
    Shapes: `p_values` (k,).

    The result equals that of ``scipy.stats.false_discovery_control``, but to import scipy.stats takes half a
    second of CPU time.
    """
    count = len(p_values)
    order = np.argsort(p_values)
    scaled = p_values[order] * (count / np.arange(1, count + 1))
    adjusted = np.empty(count)
    adjusted[order] = np.minimum.accumulate(scaled[::-1])[::-1]
    return np.minimum(adjusted, 1.0)


def _plane_trajectories(
    screening: Screening, estimate: Estimate, axis: str, x: str, y: str
) -> tuple[PlaneTrajectory, ...]:
    """Return the flights in the plane of two quantities, with the missing torque about an axis."""
    smoothed = smoothed_disturbances(screening.filtered, estimate.disturbances)
    trajectories = []
    for linear, (_, torques_Nm, _) in zip(screening.filtered.linearised_flights, smoothed, strict=True):
        rows = np.concatenate([blocks.rows for blocks in linear.blocks])
        quantities = quantity_values(linear.model.source, linear.trajectory)
        torque_Nm = torques_Nm[:, AXES.index(axis)]
        trajectories.append(
            PlaneTrajectory(quantities[x][rows], quantities[y][rows], torque_Nm - torque_Nm.mean())
        )
    return tuple(trajectories)
