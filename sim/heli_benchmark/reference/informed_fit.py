"""A fit with the true causes in the model: how significant each is, and how well the model can predict."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from heli_host.data.flight import Flight
from heli_lab.fit.identification import check, validate
from heli_lab.fit.problem import Fit, Problem, estimated_names
from heli_lab.fit.records import Record, prepare
from heli_lab.fit.shooting import solve
from heli_sim.model import MultibodyModel
from heli_sim.model.base import Effect
from heli_sim.model.effects import catalogue
from heli_sim.rig import Rig

from heli_benchmark.reference.truth import TrueEffect

_START_SHARES = (1.0, 0.3, 0.03)
"""Shares of the true sizes from which fits start."""
_GOOD_FIT = 1.03
"""Normalised error from which no further start is tried; 1 is the noise alone."""
_STEP_S = 0.004
"""With coarser steps, fits of dry friction and backlash fail."""


@dataclass(frozen=True)
class InformedFit:
    """Result of a fit with the true causes in the model."""

    train: float  # train, held_out: Normalised error on the training and on the validation flight
    held_out: float
    nothing_train: float  # nothing_train, nothing_held_out: The same of the baseline
    nothing_held_out: float
    significance: dict[str, float | None]
    """Size of each hidden effect in standard errors; None if it has no size parameter."""
    values: dict[str, float]  # values, std: Estimates of the effects' parameters, and their standard errors
    std: dict[str, float]


def fit_informed(rig: Rig, flights: tuple[Flight, Flight], hidden: Sequence[TrueEffect]) -> InformedFit:
    """Fit the baseline, and the model with the true causes."""
    records = prepare(flights[0], rig, "a"), prepare(flights[1], rig, "b")
    nothing = _fit_effects(rig, records, (), {}, None)
    kinds = catalogue()
    effects, fixed_values = [], dict[str, float]()
    for effect in hidden:
        kind = kinds[effect.id]
        if kind.baseline:
            fixed_values |= kind.override
        elif not kind.noise_inputs:
            effects.append(kind.make(effect.start))
            # A free frequency would diverge before its torque, which starts small, has grown.
            fixed_values |= {name: value for name, value in effect.start.items() if name.endswith("_Hz")}
    informed = (
        _best_of_several_starts(rig, records, effects, fixed_values, nothing)
        if effects or fixed_values
        else nothing
    )
    train, held_out = _normalised_errors(informed, records[1])
    names = {name for effect in effects for name in effect.priors}
    return InformedFit(
        train,
        held_out,
        *_normalised_errors(nothing, records[1]),
        {effect.id: _size_in_standard_errors(informed, kinds[effect.id].size) for effect in hidden},
        {name: value for name, value in informed.params.items() if name in names},
        {name: value for name, value in informed.std.items() if name in names},
    )


def _best_of_several_starts(
    rig: Rig,
    records: tuple[Record, Record],
    effects: list[Effect],
    fixed_values: dict[str, float],
    nothing: Fit,
) -> Fit:
    """Fit from several starts: the truth may be in another basin of attraction."""
    sizes = {name: effect.values[name] for effect in effects for name in effect.priors}
    best: Fit | None = None
    for share in _START_SHARES:
        start = {**nothing.params, **{name: share * value for name, value in sizes.items()}}
        fit = _fit_effects(rig, records, tuple(effects), fixed_values, start)
        if best is None or check(fit).normalised < check(best).normalised:
            best = fit
        if check(best).normalised < _GOOD_FIT:
            break
    assert best is not None
    return best


def _fit_effects(
    rig: Rig,
    records: tuple[Record, Record],
    effects: tuple[Effect, ...],
    fixed: dict[str, float],
    start: dict[str, float] | None = None,
) -> Fit:
    """Fit a model with `effects` to the training flight; `fixed` parameters are not estimated."""
    model = MultibodyModel(effects)
    problem = Problem(
        model,
        rig,
        records[:1],
        free=estimated_names(model, rig, None, list(fixed)),
        step_s=_STEP_S,
        values=fixed,
    )
    return solve(problem, start=start)


def _normalised_errors(fit: Fit, held_out: Record) -> tuple[float, float]:
    """Return the normalised errors of a fit on its own flight and on the held-out flight."""
    return check(fit).normalised, check(validate(fit, [held_out])).normalised


def _size_in_standard_errors(fit: Fit, sizes: Sequence[str]) -> float | None:
    """Return the size of an effect in standard errors (Mahalanobis distance of all its sizes from 0)."""
    indices = [i for i, name in enumerate(fit.problem.names) if name in sizes]
    if not indices:
        return None
    size = fit.theta[indices]
    covariance = fit.covariance[np.ix_(indices, indices)]
    return float(np.sqrt(size @ np.linalg.solve(covariance, size)))
