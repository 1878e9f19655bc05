"""Screening: scores of every candidate about one fit, the catalogue on its grids and the spline terms."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from heli_sim.model.effects.kind import EffectKind
from heli_sim.model.parts import AXES

from heli_lab.diagnose.candidate import Candidate, Regressors, effect_candidates, spline_candidates
from heli_lab.diagnose.disturbance_torque import DisturbanceTorque, estimate_disturbance
from heli_lab.diagnose.score_test import ScoreResult, ScoreTest
from heli_lab.identify import Fit
from heli_lab.identify.functions import Floats

_BATCH: Final = 48
"""Regressors that are scored together; the result does not depend on it, memory and time do."""
_PEAKS: Final = 4
"""Frequencies that are tried on each axis: the highest peaks of the missing torque's spectrum. Fewer: a
periodic torque beside larger disturbances is lost. More: time."""
_MIN_Hz, _MAX_Hz = 0.03, 12.0
"""Below, a period is longer than half a minute of flight; above, the arm hardly moves."""
_MAX_GRID: Final = 16
"""Points of one parameter's grid, before the best one's neighbourhood is refined."""
_BISECTIONS: Final = 6
"""Times that the grid's distance is halved about the best point: to a sixty-fourth."""
_SIZES: Final = (0.2, 0.6, 1.2)
"""Shares of the typical size at which an effect with states of its own is tried: it is not linear in it."""
_DIFFERENCE_STD: Final = 0.5
"""Prior standard deviation of the coefficient of a regressor that is the effect at such a size."""


@dataclass(frozen=True)
class Scored:
    """A candidate at the best of the `tried` points of its grid, with its score."""

    candidate: Candidate
    result: ScoreResult
    tried: int


class Screening:
    """Scores candidates around a fit."""

    def __init__(self, fit: Fit) -> None:
        self.score_test = ScoreTest(fit)
        self.regressors = tuple(Regressors(linearisation) for linearisation in self.score_test.linearisations)
        self.torques: tuple[DisturbanceTorque, ...] = tuple(
            estimate_disturbance(t) for t in self.score_test.linearisations
        )
        self.seconds = max(float(t.trajectory.t_s[-1]) for t in self.score_test.linearisations)

    def effects(
        self, kinds: Iterable[EffectKind], on_each: Callable[[str], None] | None = None
    ) -> list[Scored]:
        """Score effects of the catalogue, each at the best point of its grid, the highest score first;
        `on_each` is called with the id of each effect when it begins.
        """
        found = []
        for kind in kinds:
            if on_each is not None:
                on_each(kind.id)
            best = self._effect(kind)
            if best is not None:
                found.append(best)
        return sorted(found, key=lambda one: -one.result.log_likelihood_gain)

    def splines(self, number: int = 0) -> list[Scored]:
        """Score every spline term, the highest score first; `number` distinguishes those of one model."""
        candidates = spline_candidates(self.score_test.linearisations, number)
        results = self._score(candidates)
        found = [Scored(candidate, result, 1) for candidate, result in zip(candidates, results, strict=True)]
        return sorted(found, key=lambda one: -one.result.log_likelihood_gain)

    def _effect(self, kind: EffectKind) -> Scored | None:
        candidates = self._places(kind)
        results = self._score(candidates)
        tried = len(candidates)
        allowed = [
            (result.log_likelihood_gain, number)
            for number, (candidate, result) in enumerate(zip(candidates, results, strict=True))
            if _possible(candidate, result)
        ]
        if not allowed:
            return None
        best = max(allowed)[1]
        candidate, result = candidates[best], results[best]
        if candidate.grid and len(candidates) > 1 and result.log_likelihood_gain > 0.0:
            candidate, result, more = self._refined(kind, candidates, best, candidate, result)
            tried += more
        return Scored(candidate, result, tried)

    def _places(self, kind: EffectKind) -> list[Candidate]:
        frequency = next((q.name for q in kind.parameters if q.unit == "Hz" and q.name in kind.grid), None)
        if frequency is not None:
            axis = kind.acts_on.rpartition(".")[2]
            candidates = effect_candidates(
                replace(
                    kind,
                    numbers=tuple(
                        replace(one, grid=self._peaks(axis)) if kind.full(one.what) == frequency else one
                        for one in kind.numbers
                    ),
                ),
                self.seconds,
            )
        else:
            candidates = effect_candidates(_thinned(kind, self.seconds), self.seconds)
        if kind.states or kind.delay:
            candidates = [
                Candidate(candidate.id, kind.make(_scaled(kind, candidate, share)), (), candidate.grid)
                for candidate in candidates
                for share in _SIZES
            ]
        return candidates

    def _refined(
        self,
        kind: EffectKind,
        candidates: Sequence[Candidate],
        best: int,
        candidate: Candidate,
        result: ScoreResult,
    ) -> tuple[Candidate, ScoreResult, int]:
        """Halve the grid's distance about its best point, in parameters of three values and more."""
        tried = 0
        for name in candidate.grid:
            values = sorted({one.grid[name] for one in candidates})
            if len(values) < 3:
                continue
            prior = kind.priors.get(name)
            if prior is None:
                continue
            gaps = np.diff(values)
            place = int(np.argmin(np.abs(np.array(values) - candidate.grid[name])))
            step = float(gaps[min(place, len(gaps) - 1)])
            if name.endswith("Hz"):
                step = 0.25 / self.seconds
            for _ in range(_BISECTIONS):
                step *= 0.5
                near = []
                for value in (candidate.grid[name] - step, candidate.grid[name] + step):
                    if prior.low <= value <= prior.high:
                        grid = {**candidate.grid, name: value}
                        values_now = {**candidate.effect.values, name: value}
                        near.append(
                            Candidate(candidate.id, kind.make(values_now), candidate.linear_parameters, grid)
                        )
                tried += len(near)
                for other, score in zip(near, self._score(near), strict=True):
                    if score.log_likelihood_gain > result.log_likelihood_gain and _possible(other, score):
                        candidate, result = other, score
        return candidate, result, tried

    def _peaks(self, axis: str) -> tuple[float, ...]:
        """Frequencies of the highest peaks of the missing torque's spectrum about an axis."""
        index = AXES.index(axis)
        torque = self.torques[0]
        value = torque.value_Nm[:, index]
        step_s = float(np.median(np.diff(torque.t_s)))
        frequency_Hz = np.fft.rfftfreq(4 * len(value), step_s)
        power = np.abs(np.fft.rfft((value - value.mean()) * np.hanning(len(value)), 4 * len(value)))
        power[(frequency_Hz < _MIN_Hz) | (frequency_Hz > _MAX_Hz)] = 0.0
        top = [i for i in range(1, len(power) - 1) if power[i] >= power[i - 1] and power[i] > power[i + 1]]
        top.sort(key=lambda i: -power[i])
        return tuple(float(frequency_Hz[i]) for i in top[:_PEAKS]) or (0.5,)

    def _score(self, candidates: Sequence[Candidate]) -> list[ScoreResult]:
        results: list[ScoreResult] = []
        group: list[Candidate] = []
        width = 0
        for candidate in [*candidates, None]:
            size = 0 if candidate is None else max(1, len(candidate.linear_parameters))
            if group and (candidate is None or width + size > _BATCH):
                results += self._score_group(group)
                group, width = [], 0
            if candidate is not None:
                group.append(candidate)
                width += size
        return results

    def _score_group(self, candidates: Sequence[Candidate]) -> list[ScoreResult]:
        every = responses(self.regressors, candidates)
        sizes = [max(1, len(candidate.linear_parameters)) for candidate in candidates]
        return self.score_test.score_each(
            every, sizes, [coefficient_std(candidate) for candidate in candidates]
        )


def responses(makers: Sequence[Regressors], candidates: Sequence[Candidate]) -> list[Floats]:
    """First-order responses of the predicted angles to candidates, side by side, shape (n, 3, s) for each
    flight, as `Linearisation.response` gives them.
    """
    every: list[Floats] = []
    for maker in makers:
        pairs = [maker.signals(candidate) for candidate in candidates]
        signals = np.concatenate([rates for rates, _ in pairs], axis=2)
        measured = None
        if any(one is not None for _, one in pairs):
            shape = len(signals), 3
            measured = np.concatenate(
                [np.zeros((*shape, r.shape[2])) if one is None else one for r, one in pairs], axis=2
            )
        every.append(maker.linearisation.response(signals, measured))
    return every


def coefficient_std(candidate: Candidate) -> Floats:
    """Prior standard deviations of a candidate's coefficients about 0, shape (g,)."""
    if not candidate.linear_parameters:
        return np.array([_DIFFERENCE_STD])
    return np.array([candidate.effect.priors[name].std for name in candidate.linear_parameters])


def _thinned(kind: EffectKind, seconds: float) -> EffectKind:
    """The effect with coarser grids: the neighbourhood of the best point is refined later."""

    def thin(values: tuple[float, ...]) -> tuple[float, ...]:
        return values[:: -(-len(values) // _MAX_GRID)]

    scan = kind.grid_values(seconds)
    numbers = tuple(
        one if one.grid is None else replace(one, grid=thin(scan[kind.full(one.what)]))
        for one in kind.numbers
    )
    return replace(kind, numbers=numbers)


def _scaled(kind: EffectKind, candidate: Candidate, share: float) -> Mapping[str, float]:
    return {
        **candidate.effect.values,
        **{name: share * kind.typical[name] for name in kind.size},
    }


def _possible(candidate: Candidate, result: ScoreResult) -> bool:
    """Whether the coefficients that a score estimates have signs that their priors allow."""
    for name, change in zip(candidate.linear_parameters, result.coefficients, strict=False):
        prior = candidate.effect.priors[name]
        if prior.low >= 0.0 and change + candidate.effect.values[name] <= 0.0:
            return False
    return bool(candidate.linear_parameters) or float(result.coefficients[0]) > 0.0
