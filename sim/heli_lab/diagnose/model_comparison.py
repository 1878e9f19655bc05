"""Hypotheses: the model with some effects, estimated in innovations form; compared by likelihood ratios."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Final

import numpy as np
from heli_sim.model.base import Model
from heli_sim.rig import Rig

from heli_lab.diagnose.candidate import Candidate
from heli_lab.diagnose.kept_estimates import KeptEstimates, key_of
from heli_lab.diagnose.thresholds import EVENT_EDGE_s
from heli_lab.identify import Record
from heli_lab.identify.functions import Floats
from heli_lab.innovations import (
    BLOCK_s,
    Course,
    Estimate,
    ModelFunctions,
    Unknowns,
    estimate,
    follow,
)
from heli_lab.threads import Ahead

_FOLLOWED: Final = 2
"""Times that the course is followed anew by the baseline's own filter: after the second it moves by less than
a hundredth of the quantisation (simulated and field flights, 2026-11)."""
_OTHER_WEATHER_NATS: Final = 20.0
"""Gain over the hypothesis before from which on the weather is looked for afresh. By judgement: a cause of
six standard deviations. Higher: what a cause leaves is measured against the weather that stood for it."""
_MOST_ROWS_AHEAD: Final = 9000
"""Measurements up to which two refits are worked out at once: six minutes of flight. A refit of ten minutes
takes 0.15 GB."""
_WORSE_NATS: Final = 0.1
"""Log-likelihood by which a larger model may stay behind one that it contains, by rounding."""


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """Some effects, and the model estimated with them; compared by identity.

    Parameters
    ----------
    candidates : tuple of Candidate
        Its effects, in the order in which they were found.
    """

    candidates: tuple[Candidate, ...]
    estimate: Estimate

    @property
    def ids(self) -> tuple[str, ...]:
        """Ids of its effects."""
        return tuple(candidate.id for candidate in self.candidates)

    @property
    def log_likelihood(self) -> float:
        """Of the flights fitted, nats, priors included."""
        return self.estimate.log_likelihood

    @property
    def values(self) -> dict[str, float]:
        """Free parameters by name."""
        return dict(zip(self.estimate.unknowns.names, map(float, self.estimate.theta), strict=True))


@dataclass(frozen=True)
class Asked:
    """A refit that will be asked for: arguments of `Comparison.refit`.

    Parameters
    ----------
    candidates : sequence of Candidate
        The effects.
    start : Mapping[str, float]
        Values to start from by name.
    near : Hypothesis, optional
        A hypothesis to start from.
    """

    candidates: Sequence[Candidate]
    start: Mapping[str, float]
    near: Hypothesis | None


class Comparison:
    """Flights that all hypotheses are estimated on.

    Parameters
    ----------
    model : Model
        The model that hypotheses add effects to.
    rig : Rig
        Start values and priors of its parameters.
    train : sequence of Record
        Flights to choose and to estimate on.
    held_out : sequence of Record
        Flights on which what was chosen is judged.
    seed : int
        Seed of the bootstrap behind the intervals.
    kept : KeptEstimates, optional
        Estimates that were worked out before.

    Attributes
    ----------
    fits : int
        Refits so far, whether their estimates were kept or not; one that is asked for again is none.
    """

    def __init__(
        self,
        model: Model,
        rig: Rig,
        train: Sequence[Record],
        held_out: Sequence[Record],
        *,
        seed: int = 0,
        kept: KeptEstimates | None = None,
    ) -> None:
        self.model, self.rig, self.seed = model, rig, seed
        self._kept = kept or KeptEstimates()
        self.train, self.held_out = tuple(train), tuple(held_out)
        self.fits = 0
        self._ahead = Ahead()
        self._best: dict[frozenset[str], Hypothesis] = {}
        """The likeliest hypothesis of each set of effects that was estimated."""

    @cached_property
    def courses(self) -> tuple[Course, ...]:
        """Courses of the flights fitted, as the baseline follows them."""
        return self._followed(self.train)

    @cached_property
    def held_out_courses(self) -> tuple[Course, ...]:
        """Courses of the flights held out."""
        return self._followed(self.held_out)

    @cached_property
    def rows(self) -> int:
        """Measurements of the flights fitted."""
        step_s = self.courses[0].step_s
        return int(sum(len(course.rows) for course in self.courses) * step_s / BLOCK_s)

    def _followed(self, records: Sequence[Record]) -> tuple[Course, ...]:
        courses = tuple(follow(record) for record in records)
        unknowns = Unknowns(self.model, self.rig, records)
        functions = ModelFunctions(self.model, unknowns.quantities)
        weather, theta = None, unknowns.start
        for _ in range(_FOLLOWED):
            estimate_ = estimate(unknowns, courses, functions, theta, weather)
            weather, theta = estimate_.weather, estimate_.theta
            courses = tuple(estimate_.filtered().followed(weather))
        return courses

    def refit(
        self,
        candidates: Sequence[Candidate],
        start: Mapping[str, float] | None = None,
        near: Hypothesis | None = None,
    ) -> Hypothesis:
        """Estimate the model with some effects.

        Parameters
        ----------
        candidates : sequence of Candidate
            The effects, in place of those of any other hypothesis.
        start : Mapping[str, float], optional
            Values to start from by name, beside those of the rig and the effects.
        near : Hypothesis, optional
            A hypothesis whose parameters and weather to start from. Where this one contains it, it is never
            less likely: else the estimate begins again from there.
        """
        used_count = len(self._kept.asked)
        hypothesis = self._estimate(candidates, start or {}, near)
        if near is not None and not set(near.ids) <= {candidate.id for candidate in candidates}:
            # Fewer effects than before: what these were once with is the better place to begin.
            known = self._remembered(candidates)
            if known is not None and known.log_likelihood > hypothesis.log_likelihood + _WORSE_NATS:
                again = self._estimate(candidates, start or {}, known)
                hypothesis = max(
                    hypothesis, again, key=lambda candidate_hypothesis: candidate_hypothesis.log_likelihood
                )
        elif near is not None and hypothesis.log_likelihood < near.log_likelihood - _WORSE_NATS:
            neutral: dict[str, float] = {}
            for candidate in candidates:
                if candidate.id not in near.ids:
                    neutral |= candidate.neutral
            again = self._estimate(candidates, neutral, near)
            hypothesis = max(
                hypothesis, again, key=lambda candidate_hypothesis: candidate_hypothesis.log_likelihood
            )
        self.fits += len(self._kept.asked) > used_count
        key = frozenset(candidate.id for candidate in candidates)
        best = self._best.get(key)
        if (
            best is None
            or hypothesis.log_likelihood > best.log_likelihood
            or _grids(best.candidates) != _grids(candidates)
        ):
            best = self._best[key] = Hypothesis(tuple(candidates), hypothesis)
        return best

    def in_flight(self, hypothesis: Hypothesis) -> bool:
        """Whether the moments that an effect changes at lie within the free flight: at its edges a step is a
        constant.
        """
        spans = [
            (float(record.t_s[record.segments[0][0]] - record.t_s[0]), record.segments[-1][1] * record.step_s)
            for record in self.train
        ]
        moments = [value for name, value in hypothesis.values.items() if name.endswith("_at_s")]
        return all(any(a + EVENT_EDGE_s < moment < b - EVENT_EDGE_s for a, b in spans) for moment in moments)

    def _remembered(self, candidates: Sequence[Candidate]) -> Hypothesis | None:
        """The likeliest of what was estimated before with some of these effects and no other."""
        ids = {candidate.id for candidate in candidates}
        known = [hypothesis for key, hypothesis in self._best.items() if key <= ids]
        return max(known, key=lambda hypothesis: hypothesis.log_likelihood, default=None)

    @contextmanager
    def ahead(self, refits: Iterable[Asked]) -> Iterator[None]:
        """Have a second thread work ahead on `refits` that this block asks for in this order; not where two
        refits at once would take too much memory.
        """
        if self.rows > _MOST_ROWS_AHEAD:
            yield
            return
        works = {
            _key(*spec): partial(self._estimate, *spec, record_use=False)
            for spec in ((spec.candidates, spec.start, spec.near) for spec in refits)
        }
        with self._ahead.working(works):
            yield

    def _estimate(
        self,
        candidates: Sequence[Candidate],
        start: Mapping[str, float],
        near: Hypothesis | None,
        record_use: bool = True,
    ) -> Estimate:
        key = _key(candidates, start, near)
        if record_use:
            self._ahead.wait_for(key)
        model = type(self.model)((*self.model.effects, *(candidate.effect for candidate in candidates)))
        unknowns = Unknowns(model, self.rig, self.train)
        functions = ModelFunctions(model, unknowns.quantities)
        known = {**(near.values if near else {}), **start}
        theta = np.array(
            [
                known.get(parameter.name, value)
                for parameter, value in zip(unknowns.free, unknowns.start, strict=True)
            ]
        )
        theta = np.clip(theta, *unknowns.bounds)
        return self._kept.estimate(
            key,
            unknowns,
            self.courses,
            functions,
            lambda: self._worked_out(unknowns, functions, theta, near),
            record_use,
        )

    def _worked_out(
        self, unknowns: Unknowns, functions: ModelFunctions, theta: Floats, near: Hypothesis | None
    ) -> Estimate:
        if near is None:
            return estimate(unknowns, self.courses, functions, theta)
        estimate_ = estimate(unknowns, self.courses, functions, theta, near.estimate.weather)
        if estimate_.log_likelihood > near.log_likelihood + _OTHER_WEATHER_NATS:
            # What was missing had passed for weather: the likelihood may have another maximum now.
            other = estimate_.other_weather()
            if other is not None:
                again = estimate(unknowns, self.courses, functions, estimate_.theta, other)
                return max(estimate_, again, key=lambda candidate_estimate: candidate_estimate.log_likelihood)
        return estimate_

    def held_out_estimate(self, hypothesis: Hypothesis) -> Estimate:
        """Estimate of the flights held out: what all flights share is as the hypothesis has it, each flight's
        own constants and the weather are its own.
        """
        trained = hypothesis.estimate
        shared = {
            parameter.quantity: float(value)
            for parameter, value in zip(trained.unknowns.free, trained.theta, strict=True)
            if parameter.record is None
        }
        unknowns = Unknowns(trained.unknowns.model, self.rig, self.held_out, fixed=shared)
        functions = ModelFunctions(trained.unknowns.model, unknowns.quantities)
        weather = replace(trained.weather, curvature=None)
        return self._kept.estimate(
            key_of("held out", hypothesis.candidates, shared, trained),
            unknowns,
            self.held_out_courses,
            functions,
            lambda: estimate(unknowns, self.held_out_courses, functions, unknowns.start, weather),
        )


def _key(candidates: Sequence[Candidate], start: Mapping[str, float], near: Hypothesis | None) -> str:
    return key_of("train", candidates, start, near.estimate if near else None)


def _grids(candidates: Sequence[Candidate]) -> list[tuple[str, tuple[tuple[str, float], ...]]]:
    """What tells two sets of the same effects apart: values that no estimate moves."""
    return sorted(
        (
            candidate.id,
            tuple(
                sorted((n, v) for n, v in candidate.effect.values.items() if n not in candidate.effect.priors)
            ),
        )
        for candidate in candidates
    )
