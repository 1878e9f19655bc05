"""Equilibria of a model: trim in hover with Jacobians and linearisation, and the rest without voltage."""

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
from heli_sim.model.multibody import MultibodyModel
from heli_sim.rig import Rig
from heli_sim.rig.schema import beyond_a_table, inertias_kg_m2

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
    """Return ``derivatives(x, u, p) -> (f, A, B, P, C, D)`` of a model, named as in `Derivatives`."""
    # The Jacobians come from symbolic differentiation and are exact. The functions of 32 models are kept.
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
    """Find the voltages and the pitch that hold an elevation, with all rates zero and travel at 0."""
    # The states are three angles, their rates, and the states of effects. Unknown are pitch, the states of
    # effects, and both voltages. Travel and the three rates are zero.
    count = len(model.states)
    elevation, pitch, first_rate, first_effect_state = 0, 1, 3, 6
    unknown_states = [pitch, *range(first_effect_state, count)]
    state = np.zeros(count)
    state[elevation] = elevation_rad
    # Start at any voltage above the dead zone, because the thrust is nearly linear there.
    volts_V = np.full(2, rig["dead_zone"].value + 1.0)
    if count > first_effect_state:
        # Lagged thrusts start at their steady values: with zero thrust, pitch would have no effect.
        linear = derivatives(model, rig, state, volts_V)
        of_effects = slice(first_effect_state, None)
        change, *_ = np.linalg.lstsq(linear.A[of_effects, of_effects], linear.rates[of_effects], rcond=None)
        state[of_effects] -= change
    for _ in range(_ITERATIONS):
        linear = derivatives(model, rig, state, volts_V)
        residual = linear.rates[first_rate:]
        if np.abs(residual).max() < _RESIDUAL:
            is_upright = state[pitch] ** 2 < (np.pi / 2) ** 2
            if is_upright and (volts_V > rig["dead_zone"].value).all():
                return Trim(state, volts_V)
            break
        # Least squares leaves a state that has no influence, such as an encoder's play, unchanged.
        jacobian = np.hstack((linear.A[first_rate:, unknown_states], linear.B[first_rate:]))
        step, *_ = np.linalg.lstsq(jacobian, -residual, rcond=None)
        state_step, volts_step_V = np.split(step, [-2])
        state[unknown_states] += state_step
        volts_V = volts_V + volts_step_V
    raise PlantError(
        f"rig '{rig.name}' cannot hover at {np.degrees(elevation_rad):g} degrees with model '{model.name}'",
        "check its masses and lengths",
    )


def linearise(model: Model, rig: Rig, at: Trim | None = None) -> control.StateSpace:
    """Linearise a model about a trim, by default a level hover, with exact derivatives."""
    # The signals of the result are deviations from the trim and have names: the states of the model, the
    # inputs front_V and back_V, and as outputs the three angles that the encoders see. A PlantError is raised
    # if the rig cannot hover.
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


@dataclass(frozen=True)
class RigFindings:
    """Results that follow from all parameters of a rig together."""

    phrases: tuple[str, ...]
    """Inertias, voltages at hover, and parameters that no rig on a table has; one phrase each."""
    can_fly: bool
    """Whether the rig's supply is sufficient for a hover, and its arm comes down without voltage."""


_ELEVATION_RATE: Final = 3
"""Index of the derivative of the elevation rate among those of the states."""
_TOUCHDOWN_deg: Final = 1.5
"""Height above the table up to which the board takes an arm for landed [deg], as in supervisor.cpp."""
_MAX_FLOAT_deg: Final = 7.0
"""Greatest height of a floating arm that can land [deg]. The fall of the landing carries it onto the table.
In flights of the paper's rig with heavier counterweights, all landed at 6.5, one of two at 8.3, and none at
10.3 degrees."""


def rig_findings(rig: Rig) -> RigFindings:
    """Derive inertias, hover voltage and implausible parameters of a `rig`."""
    can_fly = True
    values = {name: number.value for name, number in rig.items()}
    inertias = inertias_kg_m2(values)
    phrases = [
        f"{len(rig)} numbers",
        ", ".join(f"{name} {value:.4g}" for name, value in inertias.items()) + " kg m2",
    ]
    try:
        front_V, back_V = trim(MultibodyModel(), rig).volts_V
        phrases.append(f"hovers at {front_V:.2f} and {back_V:.2f} V")
        if max(front_V, back_V) > rig["supply"].value:
            phrases.append(f"more than its supply of {rig['supply'].value:g} V: it cannot fly")
            can_fly = False
    except PlantError as error:
        phrases.append(f"does not hover: {error}")
        can_fly = False
    floating_deg = floating_elevation_deg(rig)
    above_deg = floating_deg - rig["elevation_min"].value
    if above_deg > _TOUCHDOWN_deg:
        phrases.append(
            f"floats without voltage at {floating_deg:.1f} degrees, {above_deg:.1f} above its table"
            + (": it may rise after a landing" if above_deg <= _MAX_FLOAT_deg else ": it cannot land")
        )
        can_fly = can_fly and above_deg <= _MAX_FLOAT_deg
    return RigFindings((*phrases, *beyond_a_table(values)), can_fly)


def floating_elevation_deg(rig: Rig) -> float:
    """Return the elevation at which the arm of a `rig` comes to rest without voltage [deg]: that of its
    table, or a higher one if its counterweight lifts it.
    """
    model = MultibodyModel()
    state = np.zeros(len(model.states))
    elevations_deg = np.linspace(rig["elevation_min"].value, rig["elevation_max"].value, 101)
    # From the table upwards: the arm rises as long as the counterweight accelerates it.
    for elevation_deg in elevations_deg:
        state[0] = np.radians(elevation_deg)
        if derivatives(model, rig, state, [0.0, 0.0]).rates[_ELEVATION_RATE] <= 0.0:
            return float(elevation_deg)
    return float(elevations_deg[-1])
