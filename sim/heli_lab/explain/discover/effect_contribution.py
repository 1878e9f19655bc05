"""Acceleration that an effect contributes along a flight."""

from __future__ import annotations

import casadi as ca
import numpy as np
from heli_host.data.arrays import Floats

from heli_lab.fit.estimator import Estimate
from heli_lab.fit.flight_model import model_along


def accelerations(estimate: Estimate, name: str, index: int = 0) -> tuple[Floats, Floats]:
    """Compute the acceleration that an effect contributes along the filtered trajectory of a flight. Returns
    shape `t_s` (n,), `change_rad_s2` (n, 3).
    """
    linear = estimate.filtered().linearised_flights[index]
    model = linear.model.source
    reduced_model = type(model)(tuple(effect for effect in model.effects if effect.name != name))
    states = [state.name for state in model.states]
    names = model.parameter_names

    def change_rad_s2(x: ca.SX, u: ca.SX, p: ca.SX, t: ca.SX) -> list[ca.SX]:
        # Difference of the models with and without the effect, at the same states and parameters.
        reduced_x = ca.vertcat(*(x[states.index(state.name)] for state in reduced_model.states))
        reduced_p = ca.vertcat(*(p[names.index(q.name)] for q in reduced_model.parameters))
        reduced_rates = reduced_model.dynamics(reduced_x, u, reduced_p, t)
        return [model.dynamics(x, u, p, t)[3:6] - reduced_rates[3:6]]

    (values,) = model_along(model, change_rad_s2)(linear.trajectory)
    return linear.trajectory.t_s, np.ascontiguousarray(values[:, :, 0])
