"""Hypotheses: the model with some effects, estimated in innovations form; compared by likelihood ratios."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

from heli_host.arrays import Floats
from heli_sim.model.base import Model
from heli_sim.rig import Rig

from heli_lab.diagnose.candidate import Candidate
from heli_lab.diagnose.estimate_cache import EstimateCache, cache_key
from heli_lab.diagnose.thresholds import EVENT_EDGE_s
from heli_lab.estimation import BLOCK_s, Estimate, ModelFunctions, ReferenceTrajectory, estimate
from heli_lab.identify import Record
from heli_lab.identify.flight_model import RigParameters, kinematic_filter, model_functions

_FOLLOWED: Final = 2
"""Times that the course is followed anew by the baseline's own filter: after the second it moves by less than
a hundredth of the quantisation (simulated and field flights, 2026-11)."""
_OTHER_WEATHER_NATS: Final = 20.0
"""Gain over the hypothesis before from which on the weather is looked for afresh. By judgement: a cause of
six standard deviations. Higher: what a cause leaves is measured against the weather that stood for it."""
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
        return dict(zip(self.estimate.parameter_vector.names, map(float, self.estimate.theta), strict=True))


class ModelComparison:
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
    kept : EstimateCache, optional
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
        kept: EstimateCache | None = None,
    ) -> None:
        self.model, self.rig, self.seed = model, rig, seed
        self._kept = kept or EstimateCache()
        self.train, self.held_out = tuple(train), tuple(held_out)
        self.fits = 0
        self._best: dict[frozenset[str], Hypothesis] = {}
        """The likeliest hypothesis of each set of effects that was estimated."""

    @cached_property
    def references(self) -> tuple[ReferenceTrajectory, ...]:
        """Courses of the flights fitted, as the baseline follows them."""
        return self._followed(self.train)

    @cached_property
    def held_out_courses(self) -> tuple[ReferenceTrajectory, ...]:
        """Courses of the flights held out."""
        return self._followed(self.held_out)

    @cached_property
    def rows(self) -> int:
        """Measurements of the flights fitted."""
        step_s = self.references[0].step_s
        return int(sum(len(reference.rows) for reference in self.references) * step_s / BLOCK_s)

    def _followed(self, records: Sequence[Record]) -> tuple[ReferenceTrajectory, ...]:
        references = tuple(kinematic_filter(record) for record in records)
        parameter_vector = RigParameters(self.model, self.rig, records)
        functions = model_functions(self.model, parameter_vector.quantities)
        disturbances, theta = None, parameter_vector.start
        for _ in range(_FOLLOWED):
            estimate_ = estimate(parameter_vector, references, functions, theta, disturbances)
            disturbances, theta = estimate_.disturbances, estimate_.theta
            references = tuple(estimate_.filtered().refiltered(disturbances))
        return references

    def refit(
        self,
        candidates: Sequence[Candidate],
        start: Mapping[str, float] | None = None,
        warm_start: Hypothesis | None = None,
    ) -> Hypothesis:
        """Estimate the model with some effects.

        Parameters
        ----------
        candidates : sequence of Candidate
            The effects, in place of those of any other hypothesis.
        start : Mapping[str, float], optional
            Values to start from by name, beside those of the rig and the effects.
        warm_start : Hypothesis, optional
            A hypothesis whose parameters and weather to start from. Where this one contains it, it is never
            less likely: else the estimate begins again from there.
        """
        used_count = len(self._kept.used_keys)
        hypothesis = self._estimate(candidates, start or {}, warm_start)
        if warm_start is not None and not set(warm_start.ids) <= {candidate.id for candidate in candidates}:
            # Fewer effects than before: what these were once with is the better place to begin.
            known = self._remembered(candidates)
            if known is not None and known.log_likelihood > hypothesis.log_likelihood + _WORSE_NATS:
                again = self._estimate(candidates, start or {}, known)
                hypothesis = max(
                    hypothesis, again, key=lambda candidate_hypothesis: candidate_hypothesis.log_likelihood
                )
        elif warm_start is not None and hypothesis.log_likelihood < warm_start.log_likelihood - _WORSE_NATS:
            neutral: dict[str, float] = {}
            for candidate in candidates:
                if candidate.id not in warm_start.ids:
                    neutral |= candidate.neutral
            again = self._estimate(candidates, neutral, warm_start)
            hypothesis = max(
                hypothesis, again, key=lambda candidate_hypothesis: candidate_hypothesis.log_likelihood
            )
        self.fits += len(self._kept.used_keys) > used_count
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

    def _estimate(
        self,
        candidates: Sequence[Candidate],
        start: Mapping[str, float],
        warm_start: Hypothesis | None,
    ) -> Estimate:
        model = type(self.model)((*self.model.effects, *(candidate.effect for candidate in candidates)))
        parameter_vector = RigParameters(model, self.rig, self.train)
        functions = model_functions(model, parameter_vector.quantities)
        known = {**(warm_start.values if warm_start else {}), **start}
        theta = parameter_vector.started_from(known)
        return self._kept.estimate(
            cache_key("train", candidates, start, warm_start.estimate if warm_start else None),
            parameter_vector,
            self.references,
            functions,
            lambda: self._worked_out(parameter_vector, functions, theta, warm_start),
        )

    def _worked_out(
        self,
        parameter_vector: RigParameters,
        functions: ModelFunctions,
        theta: Floats,
        warm_start: Hypothesis | None,
    ) -> Estimate:
        if warm_start is None:
            return estimate(parameter_vector, self.references, functions, theta)
        estimate_ = estimate(
            parameter_vector, self.references, functions, theta, warm_start.estimate.disturbances
        )
        if estimate_.log_likelihood > warm_start.log_likelihood + _OTHER_WEATHER_NATS:
            # What was missing had passed for weather: the likelihood may have another maximum now.
            other = estimate_.other_disturbances()
            if other is not None:
                again = estimate(parameter_vector, self.references, functions, estimate_.theta, other)
                return max(estimate_, again, key=lambda candidate_estimate: candidate_estimate.log_likelihood)
        return estimate_

    def held_out_estimate(self, hypothesis: Hypothesis) -> Estimate:
        """Estimate of the flights held out: what all flights share is as the hypothesis has it, each flight's
        own constants and the weather are its own.
        """
        trained = hypothesis.estimate
        shared = {
            parameter.quantity: float(value)
            for parameter, value in zip(trained.parameter_vector.free, trained.theta, strict=True)
            if parameter.record is None
        }
        parameter_vector = RigParameters(
            trained.parameter_vector.model, self.rig, self.held_out, fixed=shared
        )
        functions = model_functions(trained.parameter_vector.model, parameter_vector.quantities)
        disturbances = replace(trained.disturbances, curvature=None)
        return self._kept.estimate(
            cache_key("held out", hypothesis.candidates, shared, trained),
            parameter_vector,
            self.held_out_courses,
            functions,
            lambda: estimate(
                parameter_vector, self.held_out_courses, functions, parameter_vector.start, disturbances
            ),
        )


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
