"""Grids of the effects' nonlinear parameters, for the score tests."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final, NamedTuple

import numpy as np
from heli_host.arrays import Floats
from heli_sim.model.effects.spec import EffectSpec
from heli_sim.model.parts import AXES

from heli_lab.diagnose.search.candidate import Candidate, effect_candidates
from heli_lab.diagnose.search.spectral_peaks import peak_frequencies_Hz
from heli_lab.estimation import (
    AuxiliaryResiduals,
    DisturbanceModel,
    InnovationsModel,
    auxiliary_residuals,
    smoothed_disturbances,
)

_JUMP_WINDOW_s: Final = 1.0
"""Time before and after a moment over which torques are averaged to find a jump: longer than a step response
of the filter, shorter than slow disturbances."""
_MAX_JUMPS: Final = 3
"""Moments of jumps that are added to a grid. Fewer: of two steps the smaller is missed. More: time."""
_MAX_GRID: Final = 16
"""Points of a parameter's grid before the neighbourhood of the best point is refined."""
_SIZE_SHARES: Final = (0.2, 0.6, 1.2)
"""Shares of the typical size at which an effect with own states or a delay is tried: it is not linear in its
size."""


class _EventTimes(NamedTuple):
    """Label and duration [s] of a flight, and the moments at which an event may have happened [s]."""

    label: str
    duration_s: float
    moments_s: tuple[float, ...]


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
        """Return the points of the grid of an effect, at several sizes if it is not linear in its size."""
        frequency = next((q.name for q in kind.parameters if q.unit == "Hz" and q.name in kind.grid), None)
        if frequency is not None:
            peaks = self._peak_frequencies_Hz(kind.acts_on.rpartition(".")[2])
            numbers = tuple(
                replace(number, grid=peaks) if kind.full(number.name) == frequency else number
                for number in kind.numbers
            )
            candidates = effect_candidates(replace(kind, numbers=numbers), self.seconds)
        elif kind.full("at_s") in kind.grid:
            candidates = [
                replace(candidate, effect=replace(candidate.effect, flight=flight.label))
                for flight in self._event_times
                for candidate in effect_candidates(
                    _coarsened(kind, flight.duration_s, flight.moments_s), flight.duration_s
                )
            ]
        else:
            candidates = effect_candidates(_coarsened(kind, self.seconds, ()), self.seconds)
        if kind.states or kind.delay:
            candidates = [
                Candidate(candidate.id, kind.make(_scaled_values(kind, candidate, share)), (), candidate.grid)
                for candidate in candidates
                for share in _SIZE_SHARES
            ]
        return candidates

    @cached_property
    def _smoothed(self) -> list[tuple[Floats, Floats]]:
        """For each flight, times, (m,), and smoothed disturbance torques there, (m, 3)."""
        smoothed = smoothed_disturbances(self.filtered, self.disturbances)
        return [(t_s, torque_Nm) for t_s, torque_Nm, _ in smoothed]

    @cached_property
    def _event_times(self) -> list[_EventTimes]:
        """Return for each flight the moments at which an event may have happened.

        These are jumps of the smoothed torques, and the largest auxiliary residual of a level (de Jong and
        Penzer 1998).
        """
        result = []
        for flight, (t_s, torque_Nm), residual in zip(
            self.filtered.linearised_flights, self._smoothed, self._auxiliary_residuals, strict=True
        ):
            level_s, _ = residual.largest_level()
            jumps_s = [
                jump_s for jump_s in _jump_times_s(t_s, torque_Nm) if abs(jump_s - level_s) > _JUMP_WINDOW_s
            ]
            label, duration_s = flight.reference.record.label, float(flight.trajectory.t_s[-1])
            result.append(_EventTimes(label, duration_s, (*jumps_s, level_s)))
        return result

    @cached_property
    def _auxiliary_residuals(self) -> list[AuxiliaryResiduals]:
        """Scores of a shock at every instant of each flight."""
        return auxiliary_residuals(self.filtered, self.disturbances)

    def _peak_frequencies_Hz(self, axis: str) -> tuple[float, ...]:
        """Return the frequencies at which a periodic torque about an axis is most significant."""
        index, residuals = AXES.index(axis), self._auxiliary_residuals
        step_s = float(np.median(np.diff(residuals[0].t_s)))
        return peak_frequencies_Hz([flight.impulse.score[:, index] for flight in residuals], step_s)


def _jump_times_s(t_s: Floats, torque_Nm: Floats) -> tuple[float, ...]:
    """Return the times at which moving means of smoothed torques (m, 3) change most, over all axes [s].

    A grid needs them, because a disturbance with a correlation time of seconds hides a step from a score at
    a moment one second away.
    """
    width = max(1, round(_JUMP_WINDOW_s / float(np.median(np.diff(t_s)))))
    if len(t_s) < 4 * width:
        return ()
    sums = np.vstack((np.zeros(3), np.cumsum(torque_Nm, axis=0)))
    moving_mean_Nm = (sums[width:] - sums[:-width]) / width
    jump_Nm = np.abs(moving_mean_Nm[width:] - moving_mean_Nm[:-width])
    standardised_jump = (jump_Nm / (jump_Nm.std(axis=0) + 1e-12)).max(axis=1)
    jumps_s = []
    for _ in range(_MAX_JUMPS):
        largest = int(np.argmax(standardised_jump))
        jumps_s.append(float(t_s[largest + width]))
        standardised_jump[max(0, largest - 2 * width) : largest + 2 * width] = -1.0
    return tuple(jumps_s)


def _coarsened(kind: EffectSpec, duration_s: float, moments_s: tuple[float, ...]) -> EffectSpec:
    """Return an effect with at most `_MAX_GRID` points per parameter; `moments_s` join the grid of a moment.

    The neighbourhood of the best point is refined after the score tests.
    """
    grid_values = kind.grid_values(duration_s)

    def coarse_grid(parameter: str) -> tuple[float, ...]:
        values = grid_values[kind.full(parameter)]
        coarse = values[:: math.ceil(len(values) / _MAX_GRID)]
        return tuple(sorted({*coarse, *moments_s})) if parameter == "at_s" else coarse

    parameters = tuple(
        parameter if parameter.grid is None else replace(parameter, grid=coarse_grid(parameter.name))
        for parameter in kind.numbers
    )
    return replace(kind, numbers=parameters)


def _scaled_values(kind: EffectSpec, candidate: Candidate, share: float) -> Mapping[str, float]:
    """Return the parameters of a candidate with a `share` of the typical size."""
    return {**candidate.effect.values, **{name: share * kind.typical[name] for name in kind.size}}
