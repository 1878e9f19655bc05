"""Grids of the effects' nonlinear parameters, for the score tests."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

import numpy as np
from heli_host.arrays import Floats
from heli_sim.model.effects.spec import EffectSpec
from heli_sim.model.parts import AXES

from heli_lab.diagnose.search.candidate import Candidate, effect_candidates
from heli_lab.estimation import DisturbanceModel, InnovationsModel, auxiliary_residuals, smoothed_disturbances

_JUMP_s: Final = 1.0
"""Time before and after a moment over which torques are averaged to find a jump: longer than a step response
of the filter, shorter than slow disturbances."""
_JUMPS: Final = 3
"""Moments of jumps that are added to a grid. Fewer: of two steps the smaller is missed. More: time."""
_PEAKS: Final = 4
"""Frequencies that are tried on each axis: the highest peaks of the missing torque's spectrum. Fewer: a
periodic torque is missed among larger disturbances. More: time."""
_MIN_Hz, _MAX_Hz = 0.03, 12.0
"""Below, a period is longer than half a minute of flight; above, the arm hardly moves."""
_MAX_GRID: Final = 16
"""Points of a parameter's grid before the neighbourhood of the best point is refined."""
_SIZES: Final = (0.2, 0.6, 1.2)
"""Shares of the typical size at which an effect with own states or a delay is tried: it is not linear in its
size."""


@dataclass
class EffectGrids:
    """Lays out the grid of an effect over flights, with points where the missing torque suggests them.

    Parameters
    ----------
    filtered : InnovationsModel
        The present model along the flights.
    disturbances : DisturbanceModel
        Its disturbances, as which the torques that it lacks are smoothed.
    seconds : float
        Duration of the longest flight.
    """

    filtered: InnovationsModel
    disturbances: DisturbanceModel
    seconds: float

    def candidates(self, kind: EffectSpec) -> list[Candidate]:
        """Lay out the grid of an effect, at several sizes if it is not linear in its size."""
        frequency = next((q.name for q in kind.parameters if q.unit == "Hz" and q.name in kind.grid), None)
        if frequency is not None:
            peaks = self._peaks(kind.acts_on.rpartition(".")[2])
            numbers = tuple(
                replace(number, grid=peaks) if kind.full(number.name) == frequency else number
                for number in kind.numbers
            )
            candidates = effect_candidates(replace(kind, numbers=numbers), self.seconds)
        elif kind.full("at_s") in kind.grid:
            candidates = [
                replace(candidate, effect=replace(candidate.effect, flight=label))
                for label, seconds, jumps in zip(*self._moments, strict=True)
                for candidate in effect_candidates(_thinned(kind, seconds, jumps), seconds)
            ]
        else:
            candidates = effect_candidates(_thinned(kind, self.seconds, ()), self.seconds)
        if kind.states or kind.delay:
            candidates = [
                Candidate(candidate.id, kind.make(_scaled(kind, candidate, share)), (), candidate.grid)
                for candidate in candidates
                for share in _SIZES
            ]
        return candidates

    @cached_property
    def _smoothed(self) -> list[tuple[Floats, Floats]]:
        """For each flight, times, (m,), and smoothed disturbance torques there, (m, 3)."""
        smoothed = smoothed_disturbances(self.filtered, self.disturbances)
        return [(t_s, torque_Nm) for t_s, torque_Nm, _ in smoothed]

    @cached_property
    def _moments(self) -> tuple[list[str], list[float], list[tuple[float, ...]]]:
        """Moments at which something may have happened in each flight: jumps of the smoothed torques, and the
        most significant level shift of the auxiliary residuals.

        Returns
        -------
        labels : list of str
            Names of the flights.
        lengths_s : list of float
            Their lengths [s].
        moments_s : list of tuple of float
            The moments in each flight [s].
        """
        flights = self.filtered.linearised_flights
        residuals = auxiliary_residuals(self.filtered, self.disturbances)
        moments_s = []
        for (t_s, torque_Nm), residual in zip(self._smoothed, residuals, strict=True):
            level_s, _ = residual.largest_level()
            jumps_s = [jump_s for jump_s in _jumps(t_s, torque_Nm) if abs(jump_s - level_s) > _JUMP_s]
            moments_s.append((*jumps_s, level_s))
        labels = [flight.reference.record.label for flight in flights]
        lengths_s = [float(flight.trajectory.t_s[-1]) for flight in flights]
        return labels, lengths_s, moments_s

    def _peaks(self, axis: str) -> tuple[float, ...]:
        """Frequencies of the highest peaks in the first flight's spectrum of the torques about an axis."""
        index = AXES.index(axis)
        t_s, torque_Nm = self._smoothed[0]
        value = torque_Nm[:, index]
        step_s = float(np.median(np.diff(t_s)))
        frequency_Hz = np.fft.rfftfreq(4 * len(value), step_s)
        power = np.abs(np.fft.rfft((value - value.mean()) * np.hanning(len(value)), 4 * len(value)))
        # The spectrum of a disturbance falls with frequency: peaks are measured against that.
        power *= np.hypot(1.0, 2 * np.pi * frequency_Hz * self.disturbances.correlation_time_s[index])
        power[(frequency_Hz < _MIN_Hz) | (frequency_Hz > _MAX_Hz)] = 0.0
        top = [i for i in range(1, len(power) - 1) if power[i] >= power[i - 1] and power[i] > power[i + 1]]
        top.sort(key=lambda i: -power[i])
        return tuple(float(frequency_Hz[i]) for i in top[:_PEAKS]) or (0.5,)


def _jumps(t_s: Floats, torque_Nm: Floats) -> tuple[float, ...]:
    """Moments at which the mean of smoothed torques changes most, over all axes. A disturbance with a
    correlation time of seconds hides a step from a score at a moment one second away.
    """
    width = max(1, round(_JUMP_s / float(np.median(np.diff(t_s)))))
    if len(t_s) < 4 * width:
        return ()
    sums = np.vstack((np.zeros(3), np.cumsum(torque_Nm, axis=0)))
    means = (sums[width:] - sums[:-width]) / width
    jump = np.abs(means[width:] - means[:-width])
    height = (jump / (jump.std(axis=0) + 1e-12)).max(axis=1)
    jumps = []
    for _ in range(_JUMPS):
        top = int(np.argmax(height))
        jumps.append(float(t_s[top + width]))
        height[max(0, top - 2 * width) : top + 2 * width] = -1.0
    return tuple(jumps)


def _thinned(kind: EffectSpec, seconds: float, jumps: tuple[float, ...]) -> EffectSpec:
    """The effect with coarser grids, with `jumps` in the grid of a moment; the best point's neighbourhood is
    refined later.
    """
    scan = kind.grid_values(seconds)

    def thin(what: str) -> tuple[float, ...]:
        values = scan[kind.full(what)]
        thinned = values[:: -(-len(values) // _MAX_GRID)]
        return tuple(sorted({*thinned, *jumps})) if what == "at_s" else thinned

    numbers = tuple(
        number if number.grid is None else replace(number, grid=thin(number.name)) for number in kind.numbers
    )
    return replace(kind, numbers=numbers)


def _scaled(kind: EffectSpec, candidate: Candidate, share: float) -> Mapping[str, float]:
    return {
        **candidate.effect.values,
        **{name: share * kind.typical[name] for name in kind.size},
    }
