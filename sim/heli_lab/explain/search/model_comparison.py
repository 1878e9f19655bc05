"""Estimates models with different candidates on the same flights, so that their likelihoods can be compared.

Each model is estimated in innovations form: its one-step prediction errors have the highest likelihood.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Final

from heli_host.data.arrays import Floats
from heli_sim.model.base import Model
from heli_sim.rig import Rig

from heli_lab.explain.search.candidate import Candidate
from heli_lab.explain.search.estimate_cache import EstimateCache, cache_key
from heli_lab.explain.search.filtered_flights import FilteredFlights, filter_with_baseline
from heli_lab.explain.search.folds import two_folds
from heli_lab.explain.search.hypothesis import Hypothesis
from heli_lab.explain.thresholds import NEW_DISTURBANCES_NATS, EVENT_EDGE_s, SHORT_s
from heli_lab.fit.estimator import Estimate, estimate
from heli_lab.fit.flight_model import GAINS, ROTOR_GAINS, RigParameters
from heli_lab.fit.grey_box import DisturbanceModel
from heli_lab.fit.linearised_flight import BLOCK_s
from heli_lab.fit.model_functions import ModelFunctions
from heli_lab.fit.records import Record
from heli_lab.fit.reference_trajectory import ReferenceTrajectory

_ROUNDING_NATS: Final = 0.1
"""Rounding tolerance: a model may be less likely by this than one that it contains, nats."""


class ModelComparison:
    """Estimates models with different candidates on the same flights.

    `refit` estimates a model on the fitted flights; `held_out_estimate` evaluates it on the held-out flights.
    """

    def __init__(
        self,
        model: Model,
        rig: Rig,
        train: Sequence[Record],
        held_out: Sequence[Record],
        *,
        seed: int = 0,
        cache: EstimateCache | None = None,
        side: str = "",
    ) -> None:
        self.model, self.rig, self.seed, self.side = model, rig, seed, side
        self._cache = cache or EstimateCache()
        self.train, self.held_out = tuple(train), tuple(held_out)
        self.fits = 0
        # The most likely hypothesis for each set of candidate ids.
        self._best_by_ids: dict[frozenset[str], Hypothesis] = {}

    @property
    def references(self) -> tuple[ReferenceTrajectory, ...]:
        """Reference trajectories of the fitted flights, filtered with the baseline."""
        return self._filtered_train.references

    @property
    def held_out_references(self) -> tuple[ReferenceTrajectory, ...]:
        """Reference trajectories of the held-out flights."""
        return self._filtered_held_out.references

    @property
    def filtering_baseline(self) -> Hypothesis:
        """The baseline as it was estimated to filter the fitted flights: its values need no refit."""
        return Hypothesis((), self._filtered_train.baseline)

    @cached_property
    def _filtered_train(self) -> FilteredFlights:
        """The fitted flights, filtered with the baseline."""
        return filter_with_baseline(self.model, self.rig, self.train)

    @cached_property
    def _filtered_held_out(self) -> FilteredFlights:
        """The held-out flights, filtered with the baseline as it was estimated on them."""
        return filter_with_baseline(self.model, self.rig, self.held_out)

    def exchanged(self) -> ModelComparison:
        """Return a comparison with fitted and held-out flights exchanged; their trajectories are reused."""
        other = self._variant("exchanged", self.model, self.held_out, self.train)
        other._filtered_train, other._filtered_held_out = self._filtered_held_out, self._filtered_train
        return other

    def with_thrust_noise(self) -> ModelComparison:
        """Return a comparison in which the thrust of each rotor varies at random, in addition to torques.

        The flights are not filtered again, so that likelihoods with and without thrust noise can be compared.
        """
        model = type(self.model)((*self.model.effects, ROTOR_GAINS))
        other = self._variant("thrust noise", model, self.train, self.held_out)
        other.fits = self.fits
        other._filtered_train = self._filtered_train.with_thrust_noise(model, self.rig, self.train)
        if self.held_out:
            other._filtered_held_out = self._filtered_held_out.with_thrust_noise(
                model, self.rig, self.held_out
            )
        return other

    def refit_with_thrust_noise(self, hypothesis: Hypothesis) -> Hypothesis:
        """Refit a `hypothesis` with thrust noise.

        Call this on the result of `with_thrust_noise`; the hypothesis is from the comparison without it.
        """
        if not hypothesis.candidates:
            return self.filtering_baseline
        disturbances = hypothesis.estimate.disturbances.with_gains(len(GAINS))
        return self.refit_from(hypothesis.candidates, hypothesis.values, disturbances)

    def folds(self) -> ModelComparison | None:
        """Return a comparison that fits one half of the fitted flights and holds the other half out.

        The result is None if one of the halves is shorter than `SHORT_s`.
        """
        folds = two_folds(self.train)
        if any(sum(record.used_s for record in fold) < SHORT_s for fold in folds):
            return None
        return self._variant("fold", self.model, *folds)

    def _variant(
        self, side: str, model: Model, train: Sequence[Record], held_out: Sequence[Record]
    ) -> ModelComparison:
        """Return a comparison with the same rig, seed and cache.

        `side` is added to the keys of its estimates, so that they do not replace those of this comparison.
        """
        side = f"{self.side}{side} "
        return ModelComparison(model, self.rig, train, held_out, seed=self.seed, cache=self._cache, side=side)

    @property
    def can_test_held_out(self) -> bool:
        """Whether residuals of the held-out flights can be tested.

        Parameters that were estimated from a few seconds are too uncertain to test them on another flight.
        """
        return bool(self.held_out) and sum(record.used_s for record in self.train) > SHORT_s

    @cached_property
    def rows(self) -> int:
        """Number of measurements of the fitted flights that the filter uses: one per `BLOCK_s`."""
        step_s = self.references[0].step_s
        return int(sum(len(reference.rows) for reference in self.references) * step_s / BLOCK_s)

    def refit(
        self,
        candidates: Sequence[Candidate],
        start: Mapping[str, float] | None = None,
        warm_start: Hypothesis | None = None,
    ) -> Hypothesis:
        """Estimate the model with some candidates.

        `warm_start`: Hypothesis whose parameters and disturbances to start from. If `candidates` contain all
        of its candidates, the result must be at least as likely; if it is not, the estimation is repeated
        from values at which the new candidates have no influence.
        """
        previous_count = len(self._cache.used_keys)
        result = self._estimate(candidates, start or {}, warm_start)
        if warm_start is not None:
            result = self._retry_from_better_start(result, candidates, start or {}, warm_start)
        self.fits += len(self._cache.used_keys) > previous_count
        ids = frozenset(candidate.id for candidate in candidates)
        best = self._best_by_ids.get(ids)
        if (
            best is None
            or result.log_likelihood > best.log_likelihood
            or _fixed_values(best.candidates) != _fixed_values(candidates)
        ):
            best = self._best_by_ids[ids] = Hypothesis(tuple(candidates), result)
        return best

    def _retry_from_better_start(
        self,
        result: Estimate,
        candidates: Sequence[Candidate],
        start: Mapping[str, float],
        warm_start: Hypothesis,
    ) -> Estimate:
        """Return the `result` of a refit, or a more likely estimate from another start.

        Another start is tried if the result is less likely than a model that it contains.
        """
        likelihood = result.log_likelihood
        if not set(warm_start.ids) <= {candidate.id for candidate in candidates}:
            # The warm start has other candidates. An earlier estimate of a submodel may be a better start.
            submodel = self._best_submodel(candidates)
            if submodel is None or submodel.log_likelihood <= likelihood + _ROUNDING_NATS:
                return result
            retry = self._estimate(candidates, start, submodel)
        elif likelihood < warm_start.log_likelihood - _ROUNDING_NATS:
            new_candidates = [candidate for candidate in candidates if candidate.id not in warm_start.ids]
            neutral = {
                name: value for candidate in new_candidates for name, value in candidate.neutral.items()
            }
            retry = self._estimate(candidates, neutral, warm_start)
        else:
            return result
        return retry if retry.log_likelihood > likelihood else result

    def in_flight(self, hypothesis: Hypothesis) -> bool:
        """Whether all events of a `hypothesis` happen well within the free flight of their flights.

        At the edge of a flight, a step cannot be distinguished from a constant.
        """
        values = hypothesis.values
        for candidate in hypothesis.candidates:
            effect = candidate.effect
            if effect.moment not in values:
                continue
            flights = [record for record in self.train if effect.flight in ("", record.label)]
            if not any(event_is_inside(record, values[effect.moment]) for record in flights):
                return False
        return True

    def _best_submodel(self, candidates: Sequence[Candidate]) -> Hypothesis | None:
        """Return the most likely hypothesis so far whose candidates are all among `candidates`, or None."""
        ids = {candidate.id for candidate in candidates}
        submodels = [hypothesis for subset, hypothesis in self._best_by_ids.items() if subset <= ids]
        return max(submodels, key=lambda hypothesis: hypothesis.log_likelihood, default=None)

    def _estimate(
        self, candidates: Sequence[Candidate], start: Mapping[str, float], warm_start: Hypothesis | None
    ) -> Estimate:
        """Estimate the model with some candidates on the fitted flights, or return the cached estimate."""
        parameter_vector = self._parameter_vector(candidates)
        theta = parameter_vector.started_from({**(warm_start.values if warm_start else {}), **start})
        return self._cache.estimate(
            cache_key(f"{self.side}train", candidates, start, warm_start.estimate if warm_start else None),
            parameter_vector,
            self.references,
            lambda functions: _estimate_from(parameter_vector, self.references, functions, theta, warm_start),
        )

    def with_effects(self, hypothesis: Hypothesis, candidates: Sequence[Candidate]) -> Hypothesis:
        """Return a `hypothesis` with other `candidates` that act alike in the fitted flights.

        The estimate is unchanged. This adds, for example, the moment of an event in a held-out flight.
        """
        estimate_ = replace(hypothesis.estimate, parameter_vector=self._parameter_vector(candidates))
        return Hypothesis(tuple(candidates), estimate_)

    def _parameter_vector(self, candidates: Sequence[Candidate]) -> RigParameters:
        """Return the free parameters of a model with `candidates` in the fitted flights."""
        effects = (candidate.effect for candidate in candidates)
        return RigParameters(type(self.model)((*self.model.effects, *effects)), self.rig, self.train)

    def refit_from(
        self, candidates: Sequence[Candidate], start: Mapping[str, float], disturbances: DisturbanceModel
    ) -> Hypothesis:
        """Estimate the model with some `candidates` on the fitted flights.

        The estimation begins at `start`, values by name, and at the `disturbances` of a similar model, which
        may be those of other flights.
        """
        vector = self._parameter_vector(candidates)
        theta, disturbances = vector.started_from(start), replace(disturbances, curvature=None)
        result = self._cache.estimate(
            cache_key(f"{self.side}from", candidates, start, None, disturbances),
            vector,
            self.references,
            lambda functions: estimate(vector, self.references, functions, theta, disturbances),
        )
        return Hypothesis(tuple(candidates), result)

    def held_out_estimate(self, hypothesis: Hypothesis, warm_start: Estimate | None = None) -> Estimate:
        """Evaluate a `hypothesis` on the held-out flights.

        Only constants of each flight, such as encoder zeros, and disturbances are estimated. Parameters that
        all flights share stay at their values in the hypothesis.
        """
        fitted = hypothesis.estimate
        shared = fitted.parameter_vector.shared_by_name(fitted.theta)
        vector = RigParameters(fitted.parameter_vector.model, self.rig, self.held_out, fixed=shared)
        start = warm_start.parameter_vector.by_name(warm_start.theta) if warm_start else {}
        theta = vector.started_from(start)
        disturbances = replace((warm_start or fitted).disturbances, curvature=None)
        return self._cache.estimate(
            cache_key(f"{self.side}held out", hypothesis.candidates, {**start, **shared}, fitted),
            vector,
            self.held_out_references,
            lambda functions: estimate(vector, self.held_out_references, functions, theta, disturbances),
        )


def event_is_inside(record: Record, moment_s: float) -> bool:
    """Whether a moment, in s since the first sample, is well within the free flight of a `record`."""
    begin_s = float(record.t_s[record.segments[0][0]] - record.t_s[0])
    end_s = record.segments[-1][1] * record.step_s
    return begin_s + EVENT_EDGE_s < moment_s < end_s - EVENT_EDGE_s


def _estimate_from(
    parameter_vector: RigParameters,
    references: Sequence[ReferenceTrajectory],
    functions: ModelFunctions,
    theta: Floats,
    warm_start: Hypothesis | None,
) -> Estimate:
    """Estimate a model, starting from `theta` and from the disturbances of `warm_start`.

    If that is far more likely than the warm start, the estimation is repeated from other disturbances, and
    the more likely estimate is returned.
    """
    if warm_start is None:
        return estimate(parameter_vector, references, functions, theta)
    first = estimate(parameter_vector, references, functions, theta, warm_start.estimate.disturbances)
    if first.log_likelihood <= warm_start.log_likelihood + NEW_DISTURBANCES_NATS:
        return first
    # The disturbances of the warm start had explained a torque that the new model explains itself. With
    # smaller disturbances, the likelihood may have another maximum.
    other_disturbances = first.other_disturbances()
    if other_disturbances is None:
        return first
    second = estimate(parameter_vector, references, functions, first.theta, other_disturbances)
    return max(first, second, key=lambda result: result.log_likelihood)


def _fixed_values(candidates: Sequence[Candidate]) -> list[tuple[object, ...]]:
    """Return the fixed values and flights of candidates, which distinguish two sets of the same ids."""
    keys: list[tuple[object, ...]] = []
    for candidate in candidates:
        effect = candidate.effect
        fixed = sorted((name, value) for name, value in effect.values.items() if name not in effect.priors)
        moments_s = sorted(effect.other_moments_s.items())
        keys.append((candidate.id, effect.flight, tuple(moments_s), tuple(fixed)))
    return sorted(keys)
