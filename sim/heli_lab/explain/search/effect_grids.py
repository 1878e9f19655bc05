"""Lays out the points at which effects are scored: values of the parameters in which an effect is not linear,
such as a frequency or the moment of an event.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final, NamedTuple

import numpy as np
from heli_host.data.arrays import Floats
from heli_sim.model.effects.spec import EffectSpec
from heli_sim.model.parts import AXES

from heli_lab.explain.search.candidate import Candidate, effect_candidates
from heli_lab.explain.search.spectral_peaks import peak_frequencies_Hz
from heli_lab.fit.grey_box import DisturbanceModel
from heli_lab.fit.innovations import (
    AuxiliaryResiduals,
    InnovationsModel,
    auxiliary_residuals,
    smoothed_disturbances,
)

_JUMP_WINDOW_s: Final = 1.0
"""Time before and after a moment over which torques are averaged to find a jump: longer than a step response
of the filter, shorter than slow disturbances."""
_MAX_JUMPS: Final = 3
"""Moments of jumps that are added to a grid. Fewer: the smaller of two steps is missed. More: time."""
_MAX_GRID: Final = 16
"""Points of a parameter's grid before the neighbourhood of the best point is refined."""
_SIZE_SHARES: Final = (0.2, 0.6, 1.2)
"""Shares of the typical size at which an effect with states or a delay is tried, because it is not linear in
its size."""


class _EventTimes(NamedTuple):
    """Label and duration [s] of a flight, and the moments at which an event may have happened [s]."""

    label: str
    duration_s: float
    moments_s: tuple[float, ...]


@dataclass
class EffectGrids:
    """Lays out the grid of an effect over flights, with points where the missing torque suggests them."""

    filtered: InnovationsModel  # The present model along the flights
    disturbances: DisturbanceModel  # Its disturbances, as which the torques that it lacks are smoothed
    seconds: float  # Duration of the longest flight

    def candidates(self, kind: EffectSpec) -> list[Candidate]:
        """Return the points of the grid of an effect, at several sizes if it is not linear in its size."""
        frequency = next((q.name for q in kind.parameters if q.unit == "Hz" and q.name in kind.grid), None)
        if frequency is not None:
            candidates = self._at_peak_frequencies(kind, frequency)
        elif kind.full("at_s") in kind.grid:
            candidates = self._at_event_times(kind)
        else:
            candidates = effect_candidates(_coarsened(kind, self.seconds, ()), self.seconds)
        return _at_several_sizes(kind, candidates) if kind.states or kind.delay else candidates

    def _at_peak_frequencies(self, kind: EffectSpec, frequency: str) -> list[Candidate]:
        """Return a periodic effect at its most significant values of its parameter `frequency`."""
        peaks_Hz = self._peak_frequencies_Hz(kind.acts_on.rpartition(".")[2])
        numbers = tuple(
            replace(number, grid=peaks_Hz) if kind.full(number.name) == frequency else number
            for number in kind.numbers
        )
        return effect_candidates(replace(kind, numbers=numbers), self.seconds)

    def _at_event_times(self, kind: EffectSpec) -> list[Candidate]:
        """Return an event in each flight, at times of a coarse grid and at times that the flight suggests."""
        candidates = []
        for flight in self._event_times:
            grid = _coarsened(kind, flight.duration_s, flight.moments_s)
            candidates += [
                replace(candidate, effect=replace(candidate.effect, flight=flight.label))
                for candidate in effect_candidates(grid, flight.duration_s)
            ]
        return candidates

    @cached_property
    def _smoothed(self) -> list[tuple[Floats, Floats]]:
        """Times, (m,), and smoothed disturbance torques at these times, (m, 3), of each flight."""
        smoothed = smoothed_disturbances(self.filtered, self.disturbances)
        return [(t_s, torque_Nm) for t_s, torque_Nm, _ in smoothed]

    @cached_property
    def _event_times(self) -> list[_EventTimes]:
        """Moments at which an event may have happened, for each flight.

        These are jumps of the smoothed torques, and the instant at which a lasting change of a torque would
        be most significant, by its auxiliary residual (de Jong and Penzer 1998).
        """
        event_times = []
        for flight, (t_s, torque_Nm), residual in zip(
            self.filtered.linearised_flights, self._smoothed, self._auxiliary_residuals, strict=True
        ):
            level_s, _ = residual.largest_level()
            jumps_s = [
                jump_s for jump_s in _jump_times_s(t_s, torque_Nm) if abs(jump_s - level_s) > _JUMP_WINDOW_s
            ]
            label, duration_s = flight.reference.record.label, float(flight.trajectory.t_s[-1])
            event_times.append(_EventTimes(label, duration_s, (*jumps_s, level_s)))
        return event_times

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
    """Return the times at which smoothed torques (m, 3) jump most [s]: at most `_MAX_JUMPS`, over all axes.

    A jump is the difference between the mean torques after and before a time. A grid needs these times,
    because a disturbance with a correlation time of seconds hides a step from a score one second away.
    """
    width = max(1, round(_JUMP_WINDOW_s / float(np.median(np.diff(t_s)))))
    if len(t_s) < 4 * width:
        return ()
    sums = np.vstack((np.zeros(3), np.cumsum(torque_Nm, axis=0)))
    moving_mean_Nm = (sums[width:] - sums[:-width]) / width
    # Row i is the jump at row i + width of the torques.
    jump_Nm = np.abs(moving_mean_Nm[width:] - moving_mean_Nm[:-width])
    standardised_jump = (jump_Nm / (jump_Nm.std(axis=0) + 1e-12)).max(axis=1)
    jumps_s = []
    for _ in range(_MAX_JUMPS):
        largest = int(np.argmax(standardised_jump))
        jumps_s.append(float(t_s[largest + width]))
        # Windows that overlap with this jump show it too: exclude them.
        standardised_jump[max(0, largest - 2 * width) : largest + 2 * width] = -1.0
    return tuple(jumps_s)


def _coarsened(kind: EffectSpec, duration_s: float, moments_s: tuple[float, ...]) -> EffectSpec:
    """Return an effect whose grid has at most about `_MAX_GRID` points per parameter.

    The times `moments_s` are added to the grid of an event's moment. A coarse grid is enough, because values
    near the best point are tried after the score tests.
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


def _at_several_sizes(kind: EffectSpec, candidates: Sequence[Candidate]) -> list[Candidate]:
    """Return each candidate at several shares of the effect's typical size.

    Each then has a single coefficient, which scales the effect of that size.
    """
    sized = []
    for candidate in candidates:
        for share in _SIZE_SHARES:
            sizes = {name: share * kind.typical[name] for name in kind.size}
            effect = kind.make({**candidate.effect.values, **sizes})
            sized.append(Candidate(candidate.id, effect, (), candidate.grid))
    return sized
