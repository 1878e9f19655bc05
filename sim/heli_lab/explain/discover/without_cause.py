"""Removes one cause from a model, and computes what the model then lacks.

A cause is removed from the model, and every other parameter stays. The missing torque or angle is then
estimated from the flights, without the equation of the cause. If the estimate agrees with the contribution
of the equation, the flights confirm the equation.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from heli_sim.model.base import Model

from heli_lab.explain.discover.missing import MissingTerm
from heli_lab.explain.discover.missing_angle import missing_angle
from heli_lab.explain.discover.missing_torque import contributed_torques_Nm, missing_torque
from heli_lab.explain.search.candidate import Candidate
from heli_lab.fit.estimator import Estimate, estimate_disturbances
from heli_lab.fit.flight_model import RigParameters, model_functions


def missing_term(estimate: Estimate, cause: Candidate) -> MissingTerm:
    """Compute what a model lacks without one of its causes."""
    reduced = _without_effect(estimate, cause.effect.name)
    torques_Nm = contributed_torques_Nm(estimate, reduced)
    if any(torque_Nm.any() for torque_Nm in torques_Nm):
        return missing_torque(estimate, reduced, cause, torques_Nm)
    return missing_angle(_with_fixed_effect(estimate, cause), reduced, cause)


def _without_effect(estimate: Estimate, name: str) -> Estimate:
    """Return the estimate without the effect `name`: other parameters stay, disturbances are re-estimated."""
    model = estimate.parameter_vector.model
    reduced_model = type(model)(tuple(effect for effect in model.effects if effect.name != name))
    reduced = _with_model(estimate, reduced_model, {})
    filtered = reduced.filtered()
    disturbances = estimate_disturbances(filtered, filtered.perturbed_residual(), estimate.disturbances)
    return replace(reduced, disturbances=disturbances)


def _with_fixed_effect(estimate: Estimate, cause: Candidate) -> Estimate:
    """Return the estimate with the parameters of a cause fixed.

    If they were free, they would explain the angle that `missing_angle` estimates as a spline.
    """
    values = estimate.parameter_vector.by_name(estimate.theta)
    fixed = {name: values[name] for name in cause.effect.values if name in values}
    return _with_model(estimate, estimate.parameter_vector.model, fixed)


def _with_model(estimate: Estimate, model: Model, fixed: Mapping[str, float]) -> Estimate:
    """Return the estimate of another model at the same values of all parameters that it shares.

    `fixed` has the parameters that are not free, by name. The covariance is that of the priors.
    """
    values = estimate.parameter_vector.by_name(estimate.theta)
    records = [reference.record for reference in estimate.references]
    vector = RigParameters(model, estimate.parameter_vector.rig, records, fixed=fixed)
    start = zip(vector.names, vector.start, strict=True)
    return replace(
        estimate,
        parameter_vector=vector,
        theta=np.array([values.get(name, value) for name, value in start]),
        covariance=np.diag(vector.std**2),
        functions=model_functions(model, vector.quantities),
    )
