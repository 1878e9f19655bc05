"""Comparison of models with different candidates: each is estimated in innovations form on the same
flights.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Final

from heli_host.arrays import Floats
from heli_sim.model.base import Model
from heli_sim.rig import Rig

from heli_lab.diagnose.search.candidate import Candidate
from heli_lab.diagnose.search.estimate_cache import EstimateCache, cache_key
from heli_lab.diagnose.search.hypothesis import Hypothesis
from heli_lab.diagnose.thresholds import NEW_DISTURBANCES_NATS, EVENT_EDGE_s
from heli_lab.estimation import BLOCK_s, Estimate, ModelFunctions, ReferenceTrajectory, estimate
from heli_lab.identify import Record
from heli_lab.identify.flight_model import RigParameters, filter_record, model_functions

_FILTERED: Final = 2
"""How often the reference trajectory is filtered again with the baseline's own estimate. After the second
time it moves by less than a hundredth of the quantisation (simulated and field flights, 2026-11)."""
_WORSE_NATS: Final = 0.1
"""Rounding tolerance: a model may be less likely by this than one that it contains, nats."""


class ModelComparison:
    """Estimates models with different candidates on the same flights.

    Parameters
    ----------
    model : Model
        The baseline model, to which candidates are added.
    rig : Rig
        Start values and priors of its parameters.
    train : sequence of Record
        Flights on which candidates are chosen and parameters are estimated.
    held_out : sequence of Record
        Flights for the evaluation.
    seed : int
        Seed of the bootstrap behind the intervals.
    kept : EstimateCache, optional
        Cached estimates.

    Attributes
    ----------
    fits : int
        Number of refits so far, from the cache or not; a repeated one does not count.
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
        """The most likely hypothesis for each set of candidate ids."""

    @cached_property
    def references(self) -> tuple[ReferenceTrajectory, ...]:
        """Reference trajectories of the fitted flights, filtered with the baseline."""
        return reference_trajectories(self.model, self.rig, self.train)

    @cached_property
    def held_out_references(self) -> tuple[ReferenceTrajectory, ...]:
        """Reference trajectories of the held-out flights."""
        return reference_trajectories(self.model, self.rig, self.held_out)

    @cached_property
    def rows(self) -> int:
        """Number of measurements of the fitted flights."""
        step_s = self.references[0].step_s
        return int(sum(len(reference.rows) for reference in self.references) * step_s / BLOCK_s)

    def refit(
        self,
        candidates: Sequence[Candidate],
        start: Mapping[str, float] | None = None,
        warm_start: Hypothesis | None = None,
    ) -> Hypothesis:
        """Estimate the model with some candidates.

        Parameters
        ----------
        candidates : sequence of Candidate
            All candidates of the model.
        start : Mapping[str, float], optional
            Start values by name; by default those of `warm_start`, of the rig and of the candidates.
        warm_start : Hypothesis, optional
            Hypothesis whose parameters and disturbances to start from. If `candidates` contain its
            candidates, the result is never less likely than it: otherwise the estimate is repeated from
            neutral values.
        """
        used_count = len(self._kept.used_keys)
        hypothesis = self._estimate(candidates, start or {}, warm_start)
        if warm_start is not None and not set(warm_start.ids) <= {candidate.id for candidate in candidates}:
            # A smaller model: an earlier estimate of a part of it may be a better start.
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
        """Whether the moments at which effects of a `hypothesis` change are within the free flight that they
        belong to; at its edges, a step is a constant.
        """
        values = hypothesis.values
        return all(
            any(
                event_is_inside(record, values[candidate.effect.moment])
                for record in self.train
                if candidate.effect.flight in ("", record.label)
            )
            for candidate in hypothesis.candidates
            if candidate.effect.moment in values
        )

    def _remembered(self, candidates: Sequence[Candidate]) -> Hypothesis | None:
        """The most likely earlier hypothesis whose candidates are among these."""
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
            lambda: _estimated(parameter_vector, self.references, functions, theta, warm_start),
        )

    def with_effects(self, hypothesis: Hypothesis, candidates: Sequence[Candidate]) -> Hypothesis:
        """Return a `hypothesis` with other `candidates` that act alike in the fitted flights: the estimate is
        the same.
        """
        model = type(self.model)((*self.model.effects, *(candidate.effect for candidate in candidates)))
        vector = RigParameters(model, self.rig, self.train)
        return Hypothesis(tuple(candidates), replace(hypothesis.estimate, parameter_vector=vector))

    def held_out_estimate(self, hypothesis: Hypothesis) -> Estimate:
        """Estimate the held-out flights: parameters that all flights share are those of the `hypothesis`;
        constants of each flight and the disturbances are estimated.
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
            self.held_out_references,
            functions,
            lambda: estimate(
                parameter_vector, self.held_out_references, functions, parameter_vector.start, disturbances
            ),
        )


def event_is_inside(record: Record, moment_s: float) -> bool:
    """Whether a moment is within the free flight of a `record`, not at its edges."""
    begin_s = float(record.t_s[record.segments[0][0]] - record.t_s[0])
    end_s = record.segments[-1][1] * record.step_s
    return begin_s + EVENT_EDGE_s < moment_s < end_s - EVENT_EDGE_s


def reference_trajectories(
    model: Model, rig: Rig, records: Sequence[Record]
) -> tuple[ReferenceTrajectory, ...]:
    """Filter flights (`records`) with the baseline, a `model` of a `rig`, estimated on them."""
    references = tuple(filter_record(record) for record in records)
    parameter_vector = RigParameters(model, rig, records)
    functions = model_functions(model, parameter_vector.quantities)
    disturbances, theta = None, parameter_vector.start
    for _ in range(_FILTERED):
        estimate_ = estimate(parameter_vector, references, functions, theta, disturbances)
        disturbances, theta = estimate_.disturbances, estimate_.theta
        references = tuple(estimate_.filtered().refiltered(disturbances))
    return references


def _estimated(
    parameter_vector: RigParameters,
    references: Sequence[ReferenceTrajectory],
    functions: ModelFunctions,
    theta: Floats,
    warm_start: Hypothesis | None,
) -> Estimate:
    """Estimate from `theta` and the disturbances of `warm_start`; after a large gain from other
    disturbances too.
    """
    if warm_start is None:
        return estimate(parameter_vector, references, functions, theta)
    estimate_ = estimate(parameter_vector, references, functions, theta, warm_start.estimate.disturbances)
    if estimate_.log_likelihood > warm_start.log_likelihood + NEW_DISTURBANCES_NATS:
        # Disturbances had replaced what was missing: the likelihood may have another maximum now.
        other = estimate_.other_disturbances()
        if other is not None:
            again = estimate(parameter_vector, references, functions, estimate_.theta, other)
            return max(estimate_, again, key=lambda result: result.log_likelihood)
    return estimate_


def _grids(candidates: Sequence[Candidate]) -> list[tuple[object, ...]]:
    """Fixed values and flights of candidates, which distinguish two sets of the same ids."""
    return sorted(
        (
            candidate.id,
            candidate.effect.flight,
            tuple(sorted(candidate.effect.other_moments_s.items())),
            tuple(
                sorted((n, v) for n, v in candidate.effect.values.items() if n not in candidate.effect.priors)
            ),
        )
        for candidate in candidates
    )
