"""Compares models with different candidates on the same flights, by their likelihoods.

Each model is estimated in innovations form: its one-step prediction errors have the highest likelihood. All
models are linearised along the same states, which a baseline has filtered.

A search is deterministic: it needs the same estimates in the same order every time. The cache file of an
interrupted search therefore contains estimates only, each with a digest of everything that it depends on. A
resumed search starts again, and finds its earlier estimates in the file.
"""

from __future__ import annotations

import hashlib
import inspect
import json
import threading
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import astuple, dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Final

import numpy as np
from heli_host.data.arrays import Floats
from heli_sim.model.base import Effect, Model
from heli_sim.rig import Rig

from heli_lab.code_digest import code_digest
from heli_lab.errors import IdentifyError
from heli_lab.explain import thresholds
from heli_lab.explain.candidates import Candidate, ScoredCandidate
from heli_lab.explain.thresholds import NEW_DISTURBANCES_NATS, EVENT_EDGE_s, SHORT_s
from heli_lab.fit.estimator import Estimate, estimate
from heli_lab.fit.flight_model import GAINS, ROTOR_GAINS, RigParameters, filter_record, model_functions
from heli_lab.fit.grey_box import DisturbanceModel, GainDisturbance
from heli_lab.fit.innovations import refiltered
from heli_lab.fit.linearised_flight import BLOCK_s
from heli_lab.fit.model_functions import ModelFunctions
from heli_lab.fit.records import Record
from heli_lab.fit.reference_trajectory import ReferenceTrajectory
from heli_lab.fit.thresholds import MIN_SEGMENT_S


def split(record: Record, seconds: float) -> tuple[Record, Record]:
    """Split the free flight of a `record` after so many `seconds`."""
    rows_left = round(seconds / record.step_s)
    beginning, rest = [], []
    for start, stop in record.segments:
        split_row = min(stop, start + rows_left)
        rows_left -= split_row - start
        if split_row > start:
            beginning.append((start, split_row))
        if stop > split_row:
            rest.append((split_row, stop))
    min_rows = round(MIN_SEGMENT_S / record.step_s)
    long_segments = [(start, stop) for start, stop in rest if stop - start >= min_rows]
    return replace(record, segments=tuple(beginning)), replace(record, segments=tuple(long_segments or rest))


def two_folds(records: Sequence[Record]) -> tuple[tuple[Record, ...], tuple[Record, ...]]:
    """Divide flights (`records`) into two folds: the first and the second half of the flights, or of the free
    flight if there is only one.
    """
    if len(records) > 1:
        middle = (len(records) + 1) // 2
        return tuple(records[:middle]), tuple(records[middle:])
    first, second = split(records[0], 0.5 * records[0].used_s)
    return (first,), (second,)


_FILTER_PASSES: Final = 2
"""How often the reference trajectory is filtered again with the baseline's own estimate. After the second
time it moves by less than a hundredth of the quantisation (simulated and field flights, 2026-11)."""


@dataclass(frozen=True)
class FilteredFlights:
    """Flights with filtered states, and the baseline that was estimated to filter them."""

    references: tuple[ReferenceTrajectory, ...]  # Filtered states of each flight
    baseline: Estimate  # Estimate of the baseline on these flights

    def with_thrust_noise(self, model: Model, rig: Rig, records: Sequence[Record]) -> FilteredFlights:
        """Estimate the baseline again with a thrust that varies at random; the filtered states are
        unchanged.
        """
        vector = RigParameters(model, rig, records)
        functions = model_functions(model, vector.quantities)
        start = self.baseline.disturbances.with_gains(len(GAINS))
        baseline = estimate(vector, self.references, functions, self.baseline.theta, start)
        return FilteredFlights(self.references, baseline)


def filter_with_baseline(model: Model, rig: Rig, records: Sequence[Record]) -> FilteredFlights:
    """Estimate a baseline on some flights, and filter their states with it."""
    references = tuple(filter_record(record) for record in records)
    parameter_vector = RigParameters(model, rig, records)
    functions = model_functions(model, parameter_vector.quantities)
    disturbances, theta = None, parameter_vector.start
    for _ in range(_FILTER_PASSES):
        estimate_ = estimate(parameter_vector, references, functions, theta, disturbances)
        disturbances, theta = estimate_.disturbances, estimate_.theta
        references = tuple(refiltered(estimate_.filtered(), disturbances))
    return FilteredFlights(references, estimate_)


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """A model with some candidates, estimated on the flights; compared by identity."""

    candidates: tuple[Candidate, ...]  # The candidates in the order in which they were added
    estimate: Estimate  # The estimate in innovations form

    @property
    def ids(self) -> tuple[str, ...]:
        """Ids of the candidates."""
        return tuple(candidate.id for candidate in self.candidates)

    @property
    def log_likelihood(self) -> float:
        """Log-likelihood of the fitted flights, priors included, nats."""
        return self.estimate.log_likelihood

    @property
    def params(self) -> dict[str, float]:
        """Estimates of the free parameters by name."""
        return self.estimate.params

    @property
    def std(self) -> dict[str, float]:
        """Standard errors of the free parameters by name."""
        return self.estimate.std


@dataclass(frozen=True, eq=False)
class Refit:
    """A refit of a model with one more candidate; compared by identity."""

    hypothesis: Hypothesis  # The model with the candidate
    gain: float
    """Log-likelihood ratio over the model without it, each with its own estimate of the disturbances, nats.
    """
    penalty: float  # BIC penalty of its parameters and of the number of tests, nats
    score: float  # Gain that the score test predicted, nats
    added_id: str = ""
    """Id of the candidate that was added, if it may not be the last one: the same model may have been
    estimated before, with its candidates in another order."""

    @property
    def candidate(self) -> Candidate:
        """The candidate that was added."""
        candidates = self.hypothesis.candidates
        return next((candidate for candidate in candidates if candidate.id == self.added_id), candidates[-1])

    @property
    def margin(self) -> float:
        """Gain less penalty, nats."""
        return self.gain - self.penalty


@dataclass(frozen=True)
class Round:
    """One round of the forward selection."""

    base: Hypothesis  # The model before the round
    screened: tuple[ScoredCandidate, ...]  # All effects with their scores, the best first
    splines: tuple[ScoredCandidate, ...]  # All spline terms with their scores, the best first
    refits: tuple[Refit, ...]  # Candidates that were refitted, the largest margin first
    accepted_id: str  # Id of the candidate that was added to the model; empty if none was


@dataclass(frozen=True)
class Alternative:
    """Another effect in the place of a cause."""

    id: str  # Id of the effect
    log_likelihood_ratio: float  # Log-likelihood ratio of the cause over the effect, penalties included, nats


@dataclass(frozen=True)
class Cause:
    """An effect, or a spline term in the place of an unlisted one, with its evidence."""

    candidate: Candidate  # The effect or spline term
    train_nats: float
    """Log-likelihood ratio of the final model over the model without the cause, on the fitted flights, nats.
    """
    held_out_nats: float | None
    """The same ratio on the held-out flights, which had no part in its choice; None without such flights."""
    penalty: float  # BIC penalty, nats
    alternatives: tuple[Alternative, ...]  # Other effects that were refitted in its place, the closest first

    @property
    def effect(self) -> str:
        """Id of the effect, such as ``rotor_lag``."""
        return self.candidate.id

    @property
    def id(self) -> str:
        """Same as `effect`: candidates and alternatives have an ``id`` too."""
        return self.candidate.id

    @property
    def ambiguous_with(self) -> tuple[str, ...]:
        """Ids of the effects that these flights do not distinguish from this cause, the closest first."""
        return tuple(
            alternative.id
            for alternative in self.alternatives
            if alternative.log_likelihood_ratio < thresholds.MIN_MARGIN
        )


_PACKAGES: Final = ("heli_sim.model", "heli_lab.fit")
"""Packages whose code, compiled code included, an estimate depends on."""
_DISTURBANCES: Final = ("fast_std", "correlation_time_s", "slow_std", "quantisation", "curvature")
"""Arrays of a disturbance model."""


class EstimateCache:
    """Estimates by key, in memory and optionally in a file of one JSON object per line."""

    def __init__(self, path: Path | None = None, search_fingerprint: str = "") -> None:
        self._path = path
        self._entries: dict[str, Mapping[str, Any]] = {}
        self.used_keys: set[str] = set()
        """Keys that this search has used."""
        self._write_lock = threading.Lock()
        if path is None:
            return
        if not path.exists() or not path.stat().st_size:
            path.write_text(json.dumps({"search_of": search_fingerprint}) + "\n", encoding="utf-8")
            return
        self._read(path, search_fingerprint)

    def _read(self, path: Path, search_fingerprint: str) -> None:
        """Read the entries of a file, and remove an incomplete last line."""
        try:
            first, *lines = path.read_text(encoding="utf-8").splitlines()
            file_fingerprint = json.loads(first)["search_of"]
        except (ValueError, KeyError, TypeError):
            raise IdentifyError(f"{path} is not a --resume file", "give --resume a new file name") from None
        if file_fingerprint != search_fingerprint:
            raise IdentifyError(
                f"{path} is from a search with other flights, another rig, model or program version",
                "give another name to --resume, or the same flights, rig, model and effects",
            )
        complete_lines = 0
        for line in lines:
            try:
                entry = json.loads(line)
                self._entries[entry["key"]] = entry
            except (ValueError, KeyError):
                break
            complete_lines += 1
        # An interrupted search may have written a part of its last line.
        if complete_lines < len(lines):
            path.write_text("\n".join([first, *lines[:complete_lines]]) + "\n", encoding="utf-8")

    def estimate(
        self,
        key: str,
        parameter_vector: RigParameters,
        references: Sequence[ReferenceTrajectory],
        compute: Callable[[ModelFunctions], Estimate],
    ) -> Estimate:
        """Look up an estimate, or compute and store it. Threads may compute different keys together."""
        functions = model_functions(parameter_vector.model, parameter_vector.quantities)
        self.used_keys.add(key)
        cached = self._entries.get(key)
        if cached is not None:
            return Estimate(
                parameter_vector=parameter_vector,
                theta=np.array(cached["theta"]),
                covariance=np.array(cached["covariance"]),
                log_likelihood=cached["log_likelihood"],
                disturbances=_disturbances_of(cached["disturbances"]),
                converged=cached["converged"],
                references=tuple(references),
                functions=functions,
            )
        estimate = compute(functions)
        entry = {
            "key": key,
            "theta": estimate.theta.tolist(),
            "covariance": estimate.covariance.tolist(),
            "log_likelihood": float(estimate.log_likelihood),
            "disturbances": _disturbances_json(estimate.disturbances),
            "converged": bool(estimate.converged),
        }
        self._entries[key] = entry
        if self._path is not None:
            with self._write_lock, self._path.open("a", encoding="utf-8") as file:
                file.write(json.dumps(entry) + "\n")
        return estimate


def _disturbances_json(disturbances: DisturbanceModel) -> dict[str, Any]:
    """Return a disturbance model as JSON object."""
    arrays = {name: getattr(disturbances, name) for name in _DISTURBANCES}
    return {
        **{name: None if array is None else array.tolist() for name, array in arrays.items()},
        "gains": [astuple(gain) for gain in disturbances.gains],
    }


def _disturbances_of(content: Mapping[str, Any]) -> DisturbanceModel:
    """Return the disturbance model of a JSON object of `_disturbances_json`."""
    arrays: dict[str, Any] = {
        name: None if content[name] is None else np.array(content[name]) for name in _DISTURBANCES
    }
    return DisturbanceModel(**arrays, gains=tuple(GainDisturbance(*gain) for gain in content["gains"]))


def cache_key(
    flights: str,
    candidates: Iterable[Candidate],
    start: Mapping[str, float],
    warm_start: Estimate | None,
    disturbances: DisturbanceModel | None = None,
) -> str:
    """Return a digest of everything that an estimate depends on in addition to the `fingerprint`."""
    # A `warm_start` replaces the `disturbances`; without both, the estimate starts from those of the model.
    digest = hashlib.sha256(flights.encode())
    for candidate in candidates:
        candidate_values = (
            candidate.id,
            sorted(candidate.effect.values.items()),
            sorted(candidate.effect.priors.items()),
        )
        moments = candidate.effect.flight, sorted(candidate.effect.other_moments_s.items())
        digest.update(repr((*candidate_values, *moments, _effect_source(candidate.effect))).encode())
    digest.update(repr(sorted((name, float(value)) for name, value in start.items())).encode())
    if warm_start is not None:
        digest.update(repr((warm_start.parameter_vector.names, warm_start.log_likelihood)).encode())
        digest.update(np.ascontiguousarray(warm_start.theta).tobytes())
        disturbances = warm_start.disturbances
    if disturbances is not None:
        digest.update(json.dumps(_disturbances_json(disturbances)).encode())
    return digest.hexdigest()


def _effect_source(effect: Effect) -> str:
    """Return the source code of an effect, because a user may change it in an effect file."""
    try:
        return inspect.getsource(type(effect))
    except (OSError, TypeError):  # a class without a source file, as in a notebook
        return type(effect).__qualname__


def fingerprint(model: Model, rig: Rig, records: Iterable[Record]) -> str:
    """Return a digest of everything that all estimates of a search depend on."""
    # This is the `model`, the `rig`, the flights (`records`), and the code of the estimation.
    digest = hashlib.sha256(code_digest(packages=_PACKAGES).encode())
    effects = [(effect.name, sorted(effect.values.items())) for effect in model.effects]
    digest.update(repr((model.name, effects)).encode())
    numbers = [
        (name, quantity.value, quantity.tolerance, quantity.unit) for name, quantity in sorted(rig.items())
    ]
    digest.update(repr(numbers).encode())
    for record in records:
        digest.update(repr((record.label, record.segments)).encode())
        for array in (record.t_s, record.angles_rad, record.voltages_V):
            digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


_ROUNDING_NATS: Final = 0.1
"""Rounding tolerance: a model may be less likely by this than one that it contains, nats."""


class ModelComparison:
    """Estimates models with different candidates on the same flights."""

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

    def with_advance(self, advance_rows: Callable[[Record], float]) -> ModelComparison:
        """Return a comparison in which voltages act early by a part of a row, which depends on the log; the
        flights are filtered again.
        """
        train, held_out = (
            [replace(record, advance_rows=advance_rows(record)) for record in records]
            for records in (self.train, self.held_out)
        )
        rows = [record.advance_rows for record in (*train, *held_out)]
        other = self._variant(f"advance {rows} ", self.model, train, held_out)
        other.fits = self.fits
        return other

    def with_thrust_noise(self) -> ModelComparison:
        """Return a comparison in which the thrust of each rotor varies at random, in addition to torques."""
        # The flights are not filtered again, so that likelihoods with and without thrust noise can be
        # compared.
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
        """Refit a `hypothesis` with thrust noise."""
        # Call this on the result of `with_thrust_noise`; the hypothesis is from the comparison without it.
        if not hypothesis.candidates:
            return self.filtering_baseline
        disturbances = hypothesis.estimate.disturbances.with_gains(len(GAINS))
        return self.refit_from(hypothesis.candidates, hypothesis.params, disturbances)

    def folds(self) -> ModelComparison | None:
        """Return a comparison that fits one half of the fitted flights and holds the other half out."""
        # The result is None if one of the halves is shorter than `SHORT_s`.
        folds = two_folds(self.train)
        if any(sum(record.used_s for record in fold) < SHORT_s for fold in folds):
            return None
        return self._variant("fold", self.model, *folds)

    def _variant(
        self, side: str, model: Model, train: Sequence[Record], held_out: Sequence[Record]
    ) -> ModelComparison:
        """Return a comparison with the same rig, seed and cache."""
        # `side` is added to the keys of its estimates, so that they do not replace those of this comparison.
        side = f"{self.side}{side} "
        return ModelComparison(model, self.rig, train, held_out, seed=self.seed, cache=self._cache, side=side)

    @property
    def can_test_held_out(self) -> bool:
        """Whether residuals of the held-out flights can be tested."""
        # Parameters that were estimated from a few seconds are too uncertain to test them on another flight.
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
        """Estimate the model with some candidates."""
        # `warm_start`: Hypothesis whose parameters and disturbances to start from. If `candidates` contain
        # all of its candidates, the result must be at least as likely; if it is not, the estimation is
        # repeated from values at which the new candidates have no influence.
        previous_count = len(self._cache.used_keys)
        result = self._estimate(candidates, start or {}, warm_start)
        if warm_start is not None:
            result = self._retry_from_better_start(result, candidates, start or {}, warm_start)
        # An estimate that this search has used before costs no refit.
        self.fits += len(self._cache.used_keys) > previous_count
        ids = frozenset(candidate.id for candidate in candidates)
        best = self._best_by_ids.get(ids)
        # With other fixed values, such as the moment of a step, the same ids are another model.
        has_other_values = best is not None and _fixed_values(best.candidates) != _fixed_values(candidates)
        if best is None or has_other_values or result.log_likelihood > best.log_likelihood:
            best = self._best_by_ids[ids] = Hypothesis(tuple(candidates), result)
        return best

    def _retry_from_better_start(
        self,
        result: Estimate,
        candidates: Sequence[Candidate],
        start: Mapping[str, float],
        warm_start: Hypothesis,
    ) -> Estimate:
        """Return the `result` of a refit, or a more likely estimate from another start."""
        likelihood = result.log_likelihood
        if not set(warm_start.ids) <= {candidate.id for candidate in candidates}:
            # The warm start has other candidates. An earlier estimate of a submodel may be a better start.
            submodel = self._best_submodel(candidates)
            if submodel is None or submodel.log_likelihood <= likelihood + _ROUNDING_NATS:
                return result
            retry = self._estimate(candidates, start, submodel)
        elif likelihood < warm_start.log_likelihood - _ROUNDING_NATS:
            # More candidates must not be less likely: the estimation has missed the maximum.
            new_candidates = [candidate for candidate in candidates if candidate.id not in warm_start.ids]
            neutral = {
                name: value for candidate in new_candidates for name, value in candidate.neutral.items()
            }
            retry = self._estimate(candidates, neutral, warm_start)
        else:
            return result
        return retry if retry.log_likelihood > likelihood else result

    def in_flight(self, hypothesis: Hypothesis) -> bool:
        """Whether all events of a `hypothesis` happen well within the free flight of their flights."""
        # At the edge of a flight, a step cannot be distinguished from a constant.
        values = hypothesis.params
        for candidate in hypothesis.candidates:
            effect = candidate.effect
            if effect.moment not in values:
                continue  # no event, or at a known moment
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
        theta = parameter_vector.started_from({**(warm_start.params if warm_start else {}), **start})
        return self._cache.estimate(
            cache_key(f"{self.side}train", candidates, start, warm_start.estimate if warm_start else None),
            parameter_vector,
            self.references,
            lambda functions: _estimate_from(parameter_vector, self.references, functions, theta, warm_start),
        )

    def with_effects(self, hypothesis: Hypothesis, candidates: Sequence[Candidate]) -> Hypothesis:
        """Return a `hypothesis` with other `candidates` that act alike in the fitted flights."""
        estimate_ = replace(hypothesis.estimate, parameter_vector=self._parameter_vector(candidates))
        return Hypothesis(tuple(candidates), estimate_)

    def _parameter_vector(self, candidates: Sequence[Candidate]) -> RigParameters:
        """Return the free parameters of a model with `candidates` in the fitted flights."""
        effects = (candidate.effect for candidate in candidates)
        return RigParameters(type(self.model)((*self.model.effects, *effects)), self.rig, self.train)

    def refit_from(
        self, candidates: Sequence[Candidate], start: Mapping[str, float], disturbances: DisturbanceModel
    ) -> Hypothesis:
        """Estimate the model with some `candidates` on the fitted flights."""
        # The estimation begins at `start`, values by name, and at the `disturbances` of a similar model,
        # which may be those of other flights.
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
        """Evaluate a `hypothesis` on the held-out flights."""
        # Only constants of each flight, such as encoder zeros, and disturbances are estimated. Parameters
        # that all flights share stay at their values in the hypothesis. Without `warm_start`, constants start
        # at their priors, and disturbances at those of the fitted flights.
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
    """Estimate a model, starting from `theta` and from the disturbances of `warm_start`."""
    # If that is far more likely than the warm start, the estimation is repeated from other disturbances, and
    # the more likely estimate is returned.
    if warm_start is None:
        return estimate(parameter_vector, references, functions, theta)
    first = estimate(parameter_vector, references, functions, theta, warm_start.estimate.disturbances)
    if first.log_likelihood <= warm_start.log_likelihood + NEW_DISTURBANCES_NATS:
        return first  # the new candidates explain little: the disturbances need not change
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
