"""The truth of a case: hidden effects in the parameters of the catalogue, and a fit with the true causes."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

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

from heli_benchmark.cases.clean import Case

ParameterValues = Mapping[str, float]


@dataclass(frozen=True)
class TrueEffect:
    """A hidden effect in the catalogue's parameters."""

    id: str  # The effect
    start: ParameterValues  # Its known parameters by full name, to start a fit from
    scalars: ParameterValues
    """Parameters that the catalogue defines as the generator does: an estimate must agree with them."""
    amplitudes: Mapping[tuple[str, str], float] = field(default_factory=dict)
    """The same for amplitudes of pairs of parameters."""


def hidden_in(case: Case, motors_on_s: float) -> tuple[TrueEffect, ...]:
    """Translate the hidden effects of a case to the catalogue."""
    return tuple(translated(id_, numbers, motors_on_s) for id_, numbers in case.truth().items())


def translated(id_: str, of: ParameterValues, motors_on_s: float) -> TrueEffect:
    """Translate one effect, whose parameters the generator has as `of`."""
    # `scalars` have a true value that estimates are compared with; `start` has all starting values of a fit.
    kind, _, _ = id_.partition(".")
    prefix = id_.replace(".", "_")
    scalars = _SAME[kind](of) if kind in _SAME else {}
    if "at_s" in of:
        # The generator counts from the start of the motors, flights from the start of the log.
        scalars |= {"at_s": of["at_s"] + motors_on_s}
    start = {f"{prefix}_{what}": value for what, value in scalars.items()}
    amplitudes: dict[tuple[str, str], float] = {}
    more: dict[str, float] = {}
    if kind == "inflow_damping":
        # A loss in N per m/s, independent of the thrust, in still air.
        scalars = {"s_per_m": of["size"]}
        more = {**scalars, "loaded": 0.0, "still": 1.0}
    elif kind == "ground_effect":
        # The generator uses the height of the end of the arm; `own`, the rotor's height by pitch, is 0.
        more = {"own": 0.0}
    elif kind == "rotor_reaction_torque":
        more = {"front_m": of["size"], "back_m": of["size"] * of["back_turns"]}
        start = {}
        scalars = more
    elif kind == "axis_tilt":
        lean = math.tan(math.radians(of["size"]))
        more = {"x_rad": -lean * math.cos(of["towards_rad"]), "y_rad": -lean * math.sin(of["towards_rad"])}
        scalars = more
    elif kind == "encoder_eccentricity":
        size_rad = math.radians(of["size"])
        more = {
            "sin_rad": size_rad * math.cos(of["phase_rad"]),
            "cos_rad": size_rad * math.sin(of["phase_rad"]),
            "order": of["order"],
        }
        amplitudes = {(f"{prefix}_sin_rad", f"{prefix}_cos_rad"): size_rad}
    elif kind == "periodic_torque":
        # Its phase is unknown: from a wrong phase a fit moves to another frequency. So it starts small.
        more = {"sin_Nm": 0.05 * of["size"]}
        amplitudes = {(f"{prefix}_sin_Nm", f"{prefix}_cos_Nm"): of["size"]}
    start |= {f"{prefix}_{what}": value for what, value in more.items()}
    return TrueEffect(id_, start, {f"{prefix}_{what}": value for what, value in scalars.items()}, amplitudes)


def _ground_effect_parameters(of: ParameterValues) -> dict[str, float]:
    # The table of the generator is at the end of the arm at -25 degrees. That of the catalogue is 0.25 m
    # below the axis, and the rotors are L_theta below the arm.
    lower_m = 0.64 * math.sin(math.radians(25.0)) - 0.25 + 0.03
    return {"share": of["size"] * math.exp(-lower_m / 0.15), "height_m": 0.15}


_SAME: Mapping[str, Callable[[ParameterValues], dict[str, float]]] = {
    "rotor_lag": lambda of: {"s": of["size"]},
    "input_delay": lambda of: {"s": of["size"]},
    # k e (1 + c e) = k (1 + c) e (1 + q (e - 1)) with q = c / (1 + c).
    "thrust_quadratic": lambda of: {"share": of["size"] / (1.0 + of["size"])},
    "thrust_asymmetry": lambda of: {"share": of["size"]},
    "thrust_fade": lambda of: {"per_s": of["size"] / 60.0},
    "thrust_step": lambda of: {"share": of["size"]},
    "supply_sag": lambda of: {"per_V": of["size"] / 2.0},
    "ground_effect": _ground_effect_parameters,
    "coulomb_friction": lambda of: {"Nm": of["size"]},
    **dict.fromkeys(("pitch_drag_quadratic", "travel_drag_quadratic"), lambda of: {"Nms2": of["size"]}),
    "rotor_speed_lag": lambda of: {"s": of["size"]},
    "flywheel": lambda of: {"Nms_per_V": of["size"]},
    "supply_fade": lambda of: {"per_s": of["size"] / 60.0},
    "cable_spring": lambda of: {"Nm_per_rad": of["size"], "rest_rad": of["rest_rad"]},
    "counterweight_shift": lambda of: {"m": of["size"]},
    "backlash": lambda of: {"rad": math.radians(of["size"])},
    # If the arm starts too high, the board measures too low an angle.
    "zero_offset": lambda of: {"rad": -math.radians(of["size"])},
    "periodic_torque": lambda of: {"Hz": of["frequency_Hz"]},
    "random_torque": lambda of: {"Nm": of["size"], "s": of["lasts_s"]},
    "edgewise_flow": lambda of: {"s_per_m": of["size"]},
    "gyroscopic_torque": lambda of: {"m_s": of["size"]},
    "removed": lambda of: {"share": of["size"]},
}


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
    nothing = _fit_effects(rig, records, (), {}, start=None)
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
    """Fit a model with `effects` to the training flight, from `start` or the priors, except for parameters in
    `fixed`.
    """
    model = MultibodyModel(effects)
    problem = Problem(
        model,
        rig,
        records[:1],
        free=estimated_names(model, rig, free=None, fixed=list(fixed)),
        step_s=_STEP_S,
        values=fixed,
    )
    return solve(problem, start=start)


def _normalised_errors(fit: Fit, held_out: Record) -> tuple[float, float]:
    """Return the normalised errors of a fit on its own flight and on the held-out flight."""
    return check(fit).normalised, check(validate(fit, [held_out])).normalised


def _size_in_standard_errors(fit: Fit, sizes: Sequence[str]) -> float | None:
    """Return the size of an effect in standard errors (Mahalanobis distance of all its sizes from 0); None if
    none is free.
    """
    indices = [i for i, name in enumerate(fit.problem.names) if name in sizes]
    if not indices:
        return None
    size = fit.theta[indices]
    covariance = fit.covariance[np.ix_(indices, indices)]
    return float(np.sqrt(size @ np.linalg.solve(covariance, size)))
