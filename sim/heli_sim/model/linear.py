"""Trim of a model (an equilibrium in hover), its exact Jacobians, and its linearisation about the trim."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import casadi as ca
import numpy as np
import numpy.typing as npt
from heli_host.data.arrays import Floats

from heli_sim.errors import PlantError
from heli_sim.model.base import Model
from heli_sim.rig import Rig

if TYPE_CHECKING:
    import control


OUTPUTS: Final = ("elevation_rad", "pitch_rad", "travel_rad")
_RESIDUAL: Final = 1e-10
"""Largest rate of an equilibrium, in rad/s2, or in N/s for a lag: far below the resolution of an encoder."""
_ITERATIONS: Final = 50


@dataclass(frozen=True)
class Trim:
    """An equilibrium: `state` in the order of the model's states, shape (n,), and `volts_V`, front and back,
    shape (2,).
    """

    state: Floats
    volts_V: Floats


@dataclass(frozen=True)
class Derivatives:
    """First derivatives of a model at a point, d/dt x = f(x, u, p) and y = h(x, u, p)."""

    rates: Floats  # (n,): f itself
    A: Floats  # A, B, P: (n, n): df/dx, df/du, df/dp
    B: Floats
    P: Floats
    C: Floats  # C, D: (3, n): dh/dx, dh/du
    D: Floats


@functools.lru_cache(maxsize=32)
def derivative_function(model: Model) -> ca.Function:
    """Return ``derivatives(x, u, p) -> (f, A, B, P, C, D)`` of a model, named as in `Derivatives`.

    The Jacobians come from symbolic differentiation and are exact. The functions of 32 models are kept.
    """
    x, u = ca.SX.sym("x", len(model.states)), ca.SX.sym("u", len(model.inputs))
    p = ca.SX.sym("p", len(model.parameters))
    f, h = model.dynamics(x, u, p), model.measurement(x, u, p)
    results = [f, *(ca.jacobian(f, v) for v in (x, u, p)), *(ca.jacobian(h, v) for v in (x, u))]
    return ca.Function("derivatives", [x, u, p], ca.cse([ca.densify(result) for result in results]))


def derivatives(model: Model, rig: Rig, state: npt.ArrayLike, volts_V: npt.ArrayLike) -> Derivatives:
    """Evaluate the rates and all first derivatives of a model at a state. Shapes: `state` (n,), `volts_V`
    (2,).
    """
    results = derivative_function(model)(np.asarray(state), np.asarray(volts_V), model.parameter_values(rig))
    f, *jacobians = (np.asarray(result) for result in results)
    return Derivatives(f.ravel(), *jacobians)


def trim(model: Model, rig: Rig, elevation_rad: float = 0.0) -> Trim:
    """Find the voltages and the pitch that hold an elevation, with all rates zero and travel at 0.

    The equilibrium is computed by Newton's method with exact Jacobians.
    """
    count = len(model.states)
    # Unknown are pitch, the states of effects, and both voltages. Travel and the three rates are zero.
    unknown_states = [1, *range(6, count)]
    state = np.zeros(count)
    state[0] = elevation_rad
    # Start at any voltage above the dead zone, because the thrust is nearly linear there.
    volts_V = np.full(2, rig["dead_zone"].value + 1.0)
    if count > 6:
        # Lagged thrusts start at their steady values: with zero thrust, pitch would have no effect.
        linear = derivatives(model, rig, state, volts_V)
        state[6:] -= np.linalg.lstsq(linear.A[6:, 6:], linear.rates[6:], rcond=None)[0]
    for _ in range(_ITERATIONS):
        linear = derivatives(model, rig, state, volts_V)
        residual = linear.rates[3:]
        if np.abs(residual).max() < _RESIDUAL:
            if state[1] ** 2 < (np.pi / 2) ** 2 and (volts_V > rig["dead_zone"].value).all():
                return Trim(state, volts_V)
            break
        # Least squares leaves a state that has no influence, such as an encoder's play, unchanged.
        step = np.linalg.lstsq(
            np.hstack((linear.A[3:, unknown_states], linear.B[3:])), -residual, rcond=None
        )[0]
        state[unknown_states] += step[:-2]
        volts_V = volts_V + step[-2:]
    raise PlantError(
        f"rig '{rig.name}' cannot hover at {np.degrees(elevation_rad):g} degrees with model '{model.name}'",
        "check its masses and lengths",
    )


def linearise(model: Model, rig: Rig, at: Trim | None = None) -> control.StateSpace:
    """Linearise a model about a trim, by default a level hover, with exact derivatives.

    The signals of the result are deviations from the trim and have names: the states of the model, the inputs
    front_V and back_V, and as outputs the three angles that the encoders see. A PlantError is raised if the
    rig cannot hover.
    """
    import control

    at = at if at is not None else trim(model, rig)
    jacobians = derivatives(model, rig, at.state, at.volts_V)
    return control.ss(
        jacobians.A,
        jacobians.B,
        jacobians.C,
        jacobians.D,
        states=[state.name for state in model.states],
        inputs=[quantity.name for quantity in model.inputs],
        outputs=list(OUTPUTS),
        name=f"{model.name}_{rig.name}".replace(".", "_"),
    )
