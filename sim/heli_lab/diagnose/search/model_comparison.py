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
from heli_lab.diagnose.search.folds import two_folds
from heli_lab.diagnose.search.hypothesis import Hypothesis
from heli_lab.diagnose.thresholds import NEW_DISTURBANCES_NATS, EVENT_EDGE_s, SHORT_s
from heli_lab.estimation import (
    BLOCK_s,
    DisturbanceModel,
    Estimate,
    ModelFunctions,
    ReferenceTrajectory,
    estimate,
    refiltered,
)
from heli_lab.identify import Record
from heli_lab.identify.flight_model import RigParameters, filter_record, model_functions
from heli_lab.identify.rotor_gains import GAINS, ROTOR_GAINS

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
    side : str
        Part of the cache's key that states which flights are fitted, if several comparisons share a cache.

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
        side: str = "",
    ) -> None:
        self.model, self.rig, self.seed, self.side = model, rig, seed, side
        self._kept = kept or EstimateCache()
        self.train, self.held_out = tuple(train), tuple(held_out)
        self.fits = 0
        self._best: dict[frozenset[str], Hypothesis] = {}
        """The most likely hypothesis for each set of candidate ids."""

    @property
    def references(self) -> tuple[ReferenceTrajectory, ...]:
        """Reference trajectories of the fitted flights, filtered with the baseline."""
        return self._filtered_train[0]

    @property
    def held_out_references(self) -> tuple[ReferenceTrajectory, ...]:
        """Reference trajectories of the held-out flights."""
        return self._filtered_held_out[0]

    @property
    def filtering_baseline(self) -> Hypothesis:
        """The baseline as it was estimated to filter the fitted flights: its values need no refit."""
        return Hypothesis((), self._filtered_train[1])

    @cached_property
    def _filtered_train(self) -> tuple[tuple[ReferenceTrajectory, ...], Estimate]:
        return reference_trajectories(self.model, self.rig, self.train)

    @cached_property
    def _filtered_held_out(self) -> tuple[tuple[ReferenceTrajectory, ...], Estimate]:
        return reference_trajectories(self.model, self.rig, self.held_out)

    def exchanged(self) -> ModelComparison:
        """Return the comparison with the fitted and the held-out flights exchanged; both stay filtered."""
        other = self._like("exchanged", self.model, self.held_out, self.train)
        other._filtered_train, other._filtered_held_out = self._filtered_held_out, self._filtered_train
        return other

    def with_thrust_noise(self) -> ModelComparison:
        """Let the thrust of each rotor vary at random too; the flights stay filtered as they are, so that
        likelihoods can be compared.
        """
        model = type(self.model)((*self.model.effects, ROTOR_GAINS))
        other = self._like("thrust noise", model, self.train, self.held_out)
        other.fits = self.fits
        other._filtered_train = _with_gains(model, self.rig, self.train, *self._filtered_train)
        if self.held_out:
            other._filtered_held_out = _with_gains(model, self.rig, self.held_out, *self._filtered_held_out)
        return other

    def with_gains(self, hypothesis: Hypothesis) -> Hypothesis:
        """Estimate a `hypothesis` of a comparison without thrust noise again with it."""
        if not hypothesis.candidates:
            return self.filtering_baseline
        disturbances = hypothesis.estimate.disturbances.with_gains(len(GAINS))
        return self.refit_from(hypothesis.candidates, hypothesis.values, disturbances)

    def folds(self) -> ModelComparison | None:
        """Divide the fitted flights into two folds where no flight is held out: the first is fitted, the
        second held out. None if one of them is shorter than `SHORT_s`.
        """
        folds = two_folds(self.train)
        if any(sum(record.used_s for record in fold) < SHORT_s for fold in folds):
            return None
        return self._like("fold", self.model, *folds)

    def _like(
        self, side: str, model: Model, train: Sequence[Record], held_out: Sequence[Record]
    ) -> ModelComparison:
        """Return a comparison with the same rig, seed and cache; `side` is added to the key of its cached
        estimates.
        """
        side = f"{self.side}{side} "
        return ModelComparison(model, self.rig, train, held_out, seed=self.seed, kept=self._kept, side=side)

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
        result = self._estimate(candidates, start or {}, warm_start)
        if warm_start is not None:
            result = self._from_better_start(result, candidates, start or {}, warm_start)
        self.fits += len(self._kept.used_keys) > used_count
        key = frozenset(candidate.id for candidate in candidates)
        best = self._best.get(key)
        if (
            best is None
            or result.log_likelihood > best.log_likelihood
            or _grids(best.candidates) != _grids(candidates)
        ):
            best = self._best[key] = Hypothesis(tuple(candidates), result)
        return best

    def _from_better_start(
        self,
        result: Estimate,
        candidates: Sequence[Candidate],
        start: Mapping[str, float],
        warm_start: Hypothesis,
    ) -> Estimate:
        """Return the `result` of a refit, or a more likely one from another start, if that is worth a try."""
        likelihood = result.log_likelihood
        if not set(warm_start.ids) <= {candidate.id for candidate in candidates}:
            # A smaller model: an earlier estimate of a part of it may be a better start.
            known = self._remembered(candidates)
            if known is None or known.log_likelihood <= likelihood + _WORSE_NATS:
                return result
            again = self._estimate(candidates, start, known)
        elif likelihood < warm_start.log_likelihood - _WORSE_NATS:
            added = [candidate for candidate in candidates if candidate.id not in warm_start.ids]
            neutral = {name: value for candidate in added for name, value in candidate.neutral.items()}
            again = self._estimate(candidates, neutral, warm_start)
        else:
            return result
        return again if again.log_likelihood > likelihood else result

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
        """Estimate of the model with `candidates` on the fitted flights, from `start` values and a
        `warm_start`; cached.
        """
        parameter_vector = self._vector(candidates)
        functions = model_functions(parameter_vector.model, parameter_vector.quantities)
        known = {**(warm_start.values if warm_start else {}), **start}
        theta = parameter_vector.started_from(known)
        return self._kept.estimate(
            cache_key(f"{self.side}train", candidates, start, warm_start.estimate if warm_start else None),
            parameter_vector,
            self.references,
            functions,
            lambda: _estimated(parameter_vector, self.references, functions, theta, warm_start),
        )

    def with_effects(self, hypothesis: Hypothesis, candidates: Sequence[Candidate]) -> Hypothesis:
        """Return a `hypothesis` with other `candidates` that act alike in the fitted flights: the estimate is
        the same.
        """
        estimate_ = replace(hypothesis.estimate, parameter_vector=self._vector(candidates))
        return Hypothesis(tuple(candidates), estimate_)

    def _vector(self, candidates: Sequence[Candidate]) -> RigParameters:
        """Free parameters of the model with some `candidates` in the fitted flights."""
        effects = (candidate.effect for candidate in candidates)
        return RigParameters(type(self.model)((*self.model.effects, *effects)), self.rig, self.train)

    def refit_from(
        self, candidates: Sequence[Candidate], start: Mapping[str, float], disturbances: DisturbanceModel
    ) -> Hypothesis:
        """Estimate the model with some `candidates` from `start`, values by name, and from `disturbances` of
        a similar model, perhaps of other flights.
        """
        vector = self._vector(candidates)
        functions = model_functions(vector.model, vector.quantities)
        theta, disturbances = vector.started_from(start), replace(disturbances, curvature=None)
        result = self._kept.estimate(
            cache_key(f"{self.side}from", candidates, start, None, disturbances),
            vector,
            self.references,
            functions,
            lambda: estimate(vector, self.references, functions, theta, disturbances),
        )
        return Hypothesis(tuple(candidates), result)

    def held_out_estimate(self, hypothesis: Hypothesis, near: Estimate | None = None) -> Estimate:
        """Estimate the held-out flights: parameters that all flights share are those of the `hypothesis`;
        constants of each flight and the disturbances are estimated, from an estimate `near` them if given.
        """
        trained = hypothesis.estimate
        shared = trained.parameter_vector.shared_by_name(trained.theta)
        parameter_vector = RigParameters(
            trained.parameter_vector.model, self.rig, self.held_out, fixed=shared
        )
        functions = model_functions(trained.parameter_vector.model, parameter_vector.quantities)
        known = near.parameter_vector.by_name(near.theta) if near else {}
        theta = parameter_vector.started_from(known)
        disturbances = replace((near or trained).disturbances, curvature=None)
        return self._kept.estimate(
            cache_key(f"{self.side}held out", hypothesis.candidates, {**known, **shared}, trained),
            parameter_vector,
            self.held_out_references,
            functions,
            lambda: estimate(parameter_vector, self.held_out_references, functions, theta, disturbances),
        )


def event_is_inside(record: Record, moment_s: float) -> bool:
    """Whether a moment is within the free flight of a `record`, not at its edges."""
    begin_s = float(record.t_s[record.segments[0][0]] - record.t_s[0])
    end_s = record.segments[-1][1] * record.step_s
    return begin_s + EVENT_EDGE_s < moment_s < end_s - EVENT_EDGE_s


def reference_trajectories(
    model: Model, rig: Rig, records: Sequence[Record]
) -> tuple[tuple[ReferenceTrajectory, ...], Estimate]:
    """Filter flights (`records`) with the baseline, a `model` of a `rig`, estimated on them; return that
    estimate too.
    """
    references = tuple(filter_record(record) for record in records)
    parameter_vector = RigParameters(model, rig, records)
    functions = model_functions(model, parameter_vector.quantities)
    disturbances, theta = None, parameter_vector.start
    for _ in range(_FILTERED):
        estimate_ = estimate(parameter_vector, references, functions, theta, disturbances)
        disturbances, theta = estimate_.disturbances, estimate_.theta
        references = tuple(refiltered(estimate_.filtered(), disturbances))
    return references, estimate_


def _with_gains(
    model: Model,
    rig: Rig,
    records: Sequence[Record],
    references: tuple[ReferenceTrajectory, ...],
    baseline: Estimate,
) -> tuple[tuple[ReferenceTrajectory, ...], Estimate]:
    """Estimate a model with random rotor gains, that is with thrust noise, on flights that stay filtered.

    Parameters
    ----------
    model : Model
        The model with `ROTOR_GAINS`.
    references : tuple of ReferenceTrajectory
        The flights, filtered without thrust noise.
    baseline : Estimate
        Estimate of the model without thrust noise, from which the search starts.

    Returns
    -------
    references : tuple of ReferenceTrajectory
        The same references.
    estimate : Estimate
        Estimate with thrust noise.
    """
    vector = RigParameters(model, rig, records)
    functions = model_functions(model, vector.quantities)
    start = baseline.disturbances.with_gains(len(GAINS))
    return references, estimate(vector, references, functions, baseline.theta, start)


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
