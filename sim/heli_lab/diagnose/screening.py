"""Scores of every candidate around one fit: the catalogue at all its places, and the patterns."""

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
_PEAKS: Final = 4
"""Frequencies that are tried on each axis: the highest peaks of the missing torque's spectrum."""
_LOWEST_Hz, _HIGHEST_Hz = 0.03, 12.0
_MOST_PLACES: Final = 16
"""Values of one number that are tried before the best one's surroundings are."""
_REFINED: Final = 6
"""Times that the distance of searched values is halved about the best one."""
_SIZES: Final = (0.2, 0.6, 1.2)
"""Shares of the typical size at which an effect with states of its own is tried: it is not linear in it."""


@dataclass(frozen=True)
class Scored:
    """A candidate with its score.

    Parameters
    ----------
    candidate : Candidate
        The candidate at its best place.
    answer : ScoreResult
        What it would gain.
    tried : int
        Number of places that were tried.
    """

    candidate: Candidate
    answer: ScoreResult
    tried: int


class Screening:
    """Scores candidates around a fit.

    Parameters
    ----------
    fit : Fit
        The fit.
    """

    def __init__(self, fit: Fit) -> None:
        self.ground = ScoreTest(fit)
        self.columns = tuple(Regressors(tangent) for tangent in self.ground.tangents)
        self.torques: tuple[DisturbanceTorque, ...] = tuple(
            estimate_disturbance(t) for t in self.ground.tangents
        )
        self.seconds = max(float(t.path.t_s[-1]) for t in self.ground.tangents)

    def effects(
        self, kinds: Iterable[EffectKind], on_each: Callable[[str], None] | None = None
    ) -> list[Scored]:
        """Score effects of the catalogue, each at its best place.

        Parameters
        ----------
        kinds : iterable of EffectKind
            The effects.
        on_each : callable, optional
            Told the id of each effect when it begins.

        Returns
        -------
        list of Scored
            One an effect, the highest score first.
        """
        found = []
        for kind in kinds:
            if on_each is not None:
                on_each(kind.id)
            best = self._effect(kind)
            if best is not None:
                found.append(best)
        return sorted(found, key=lambda one: -one.answer.gain)

    def splines(self, number: int = 0) -> list[Scored]:
        """Score every pattern.

        Parameters
        ----------
        number : int
            Tells patterns of one model apart.

        Returns
        -------
        list of Scored
            The highest score first.
        """
        candidates = spline_candidates(self.ground.tangents, number)
        answers = self._answers(candidates)
        found = [Scored(candidate, answer, 1) for candidate, answer in zip(candidates, answers, strict=True)]
        return sorted(found, key=lambda one: -one.answer.gain)

    def _effect(self, kind: EffectKind) -> Scored | None:
        candidates = self._places(kind)
        answers = self._answers(candidates)
        tried = len(candidates)
        allowed = [
            (answer.gain, number)
            for number, (candidate, answer) in enumerate(zip(candidates, answers, strict=True))
            if _possible(candidate, answer)
        ]
        if not allowed:
            return None
        best = max(allowed)[1]
        candidate, answer = candidates[best], answers[best]
        if candidate.scanned and len(candidates) > 1 and answer.gain > 0.0:
            candidate, answer, more = self._refined(kind, candidates, best, candidate, answer)
            tried += more
        return Scored(candidate, answer, tried)

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
                Candidate(candidate.id, kind.make(_scaled(kind, candidate, share)), (), candidate.scanned)
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
        answer: ScoreResult,
    ) -> tuple[Candidate, ScoreResult, int]:
        """Halve the distance of searched values about the best, where they are many."""
        tried = 0
        for name in candidate.scanned:
            values = sorted({one.scanned[name] for one in candidates})
            if len(values) < 3:
                continue
            prior = kind.priors.get(name)
            if prior is None:
                continue
            gaps = np.diff(values)
            place = int(np.argmin(np.abs(np.array(values) - candidate.scanned[name])))
            step = float(gaps[min(place, len(gaps) - 1)])
            if name.endswith("Hz"):
                step = 0.25 / self.seconds
            for _ in range(_REFINED):
                step *= 0.5
                near = []
                for value in (candidate.scanned[name] - step, candidate.scanned[name] + step):
                    if prior.low <= value <= prior.high:
                        scanned = {**candidate.scanned, name: value}
                        values_now = {**candidate.effect.values, name: value}
                        near.append(Candidate(candidate.id, kind.make(values_now), candidate.size, scanned))
                tried += len(near)
                for other, result in zip(near, self._answers(near), strict=True):
                    if result.gain > answer.gain and _possible(other, result):
                        candidate, answer = other, result
        return candidate, answer, tried

    def _peaks(self, axis: str) -> tuple[float, ...]:
        """Frequencies of the highest peaks of the missing torque of an axis."""
        index = AXES.index(axis)
        torque = self.torques[0]
        value = torque.value_Nm[:, index]
        step_s = float(np.median(np.diff(torque.t_s)))
        frequency_Hz = np.fft.rfftfreq(4 * len(value), step_s)
        power = np.abs(np.fft.rfft((value - value.mean()) * np.hanning(len(value)), 4 * len(value)))
        power[(frequency_Hz < _LOWEST_Hz) | (frequency_Hz > _HIGHEST_Hz)] = 0.0
        top = [i for i in range(1, len(power) - 1) if power[i] >= power[i - 1] and power[i] > power[i + 1]]
        top.sort(key=lambda i: -power[i])
        return tuple(float(frequency_Hz[i]) for i in top[:_PEAKS]) or (0.5,)

    def _answers(self, candidates: Sequence[Candidate]) -> list[ScoreResult]:
        answers: list[ScoreResult] = []
        group: list[Candidate] = []
        width = 0
        for candidate in [*candidates, None]:
            size = 0 if candidate is None else max(1, len(candidate.size))
            if group and (candidate is None or width + size > _BATCH):
                answers += self._group(group)
                group, width = [], 0
            if candidate is not None:
                group.append(candidate)
                width += size
        return answers

    def _group(self, candidates: Sequence[Candidate]) -> list[ScoreResult]:
        every = answers(self.columns, candidates)
        sizes = [max(1, len(candidate.size)) for candidate in candidates]
        return self.ground.score_each(every, sizes, [spread(candidate) for candidate in candidates])


def answers(makers: Sequence[Regressors], candidates: Sequence[Candidate]) -> list[Floats]:
    """Predict what candidates change in the angles, side by side.

    Parameters
    ----------
    makers : sequence of Regressors
        One for each flight.
    candidates : sequence of Candidate
        The candidates.

    Returns
    -------
    list of ndarray (n, 3, s)
        One for each flight, as `Linearisation.answer` gives them.
    """
    every: list[Floats] = []
    for columns in makers:
        pairs = [columns.signals(candidate) for candidate in candidates]
        signals = np.concatenate([rates for rates, _ in pairs], axis=2)
        seen = None
        if any(one is not None for _, one in pairs):
            shape = len(signals), 3
            seen = np.concatenate(
                [np.zeros((*shape, r.shape[2])) if one is None else one for r, one in pairs], axis=2
            )
        every.append(columns.tangent.answer(signals, seen))
    return every


def spread(candidate: Candidate) -> Floats:
    """Say what is known of a candidate's coefficients before any flight.

    Parameters
    ----------
    candidate : Candidate
        The candidate.

    Returns
    -------
    ndarray (g,)
        Their standard deviations about 0.
    """
    if not candidate.size:
        return np.array([0.5])
    return np.array([candidate.effect.priors[name].std for name in candidate.size])


def _thinned(kind: EffectKind, seconds: float) -> EffectKind:
    """The effect with fewer values to search over: the best one's surroundings are searched finely later."""

    def thin(values: tuple[float, ...]) -> tuple[float, ...]:
        return values[:: -(-len(values) // _MOST_PLACES)]

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


def _possible(candidate: Candidate, answer: ScoreResult) -> bool:
    """Whether the size that a score asks for has a sign that it may have."""
    for name, change in zip(candidate.size, answer.size, strict=False):
        prior = candidate.effect.priors[name]
        if prior.low >= 0.0 and change + candidate.effect.values[name] <= 0.0:
            return False
    return bool(candidate.size) or float(answer.size[0]) > 0.0
