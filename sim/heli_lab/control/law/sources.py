"""Control laws made from a gain matrix, a state space, or a CasADi function."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import casadi as ca
import numpy as np
import numpy.typing as npt
from heli_host.declaration import AXES, LAW_INPUTS
from heli_host.errors import BadLaw

from heli_lab.control.law.blocks import motor_volts
from heli_lab.control.law.law import Command, Law, control_law
from heli_lab.control.law.law_function import column_of

if TYPE_CHECKING:
    import control

ERRORS = (*(f"{axis}_rad" for axis in AXES), *(f"{axis}_rad_s" for axis in AXES))
"""States of a gain matrix: angles, then rates, each against its setpoint; pitch's setpoint is level."""


def _tracking_errors(now: Any) -> Any:
    """Return the six `ERRORS` as a column: inputs of a law, `now`, minus their setpoints."""
    errors = []
    for name in ERRORS:
        setpoint_name = name.replace("_rad", "_setpoint_rad", 1)
        setpoint = 0.0 if name.startswith("pitch") else getattr(now, setpoint_name, 0.0)
        errors.append(getattr(now, name) - setpoint)
    return ca.vertcat(*errors)


def from_gain(
    K: npt.ArrayLike, *, hover_V: float, rate_Hz: float = 1000.0, dead_zone_V: float = 1.0, name: str = "gain"
) -> Law:
    """Make a law from a gain matrix: collective and differential are hover's minus ``K`` times the error.

    Parameters
    ----------
    K : array_like, shape (2, 6)
        Gains of collective and differential [V] on the errors of elevation, pitch and travel [rad] and of
        their rates [rad/s].
    hover_V : float
        Collective that carries the arm at level, above the dead zones [V].
    rate_Hz : float
        Calls per second [Hz].
    dead_zone_V : float
        Voltage below which a rotor gives no thrust [V].
    name : str
        Name of the law for readers.

    Raises
    ------
    BadLaw
        The matrix has another shape, or holds a value that is not finite.
    """
    shape_text = f"give 2 x {len(ERRORS)} numbers: collective and differential on {', '.join(ERRORS)}"
    try:
        gains = np.asarray(K, float)
    except (TypeError, ValueError) as error:
        raise BadLaw(f"the gain matrix is no array of numbers: {error}", shape_text) from error
    if gains.shape != (2, len(ERRORS)):
        raise BadLaw(f"the gain matrix is {' x '.join(map(str, gains.shape))}", shape_text)
    if not np.isfinite(gains).all():
        row, column = np.argwhere(~np.isfinite(gains))[0]
        raise BadLaw(
            f"the gain of {('collective', 'differential')[row]} on {ERRORS[column]} is {gains[row, column]}",
            "give a finite number; if it was computed, check the design of the gains",
        )

    @control_law(rate_Hz=rate_Hz, name=name, parameters={"hover_V": hover_V})
    def law(now: Any, state: Any, parameter: Any) -> Command:
        """Multiply the errors by the gains, and convert the result to motor voltages."""
        command_V = -ca.mtimes(ca.DM(gains), _tracking_errors(now))
        return Command(*motor_volts(parameter.hover_V + command_V[0], command_V[1], dead_zone_V))

    return law


def from_state_space(
    system: control.StateSpace,
    *,
    hover_V: float,
    rate_Hz: float = 1000.0,
    dead_zone_V: float = 1.0,
    name: str = "state_space",
) -> Law:
    """Make a law from a linear system: from six errors, as in `from_gain`, to collective and differential.

    Parameters
    ----------
    system : control.StateSpace
        Continuous system, which is then sampled by a bilinear transform, or discrete system at `rate_Hz`.
    hover_V, rate_Hz, dead_zone_V : float
        As in `from_gain`.
    name : str
        Name of the law for readers.

    Raises
    ------
    BadLaw
        The system has other inputs or outputs, or was sampled at another rate.
    """
    if (system.noutputs, system.ninputs) != (2, len(ERRORS)):
        raise BadLaw(
            f"the system has {system.ninputs} inputs and {system.noutputs} outputs",
            f"give {len(ERRORS)} inputs ({', '.join(ERRORS)}) and 2 outputs (collective, differential)",
        )
    if system.isctime(strict=False) and not system.isdtime(strict=True):
        system = system.sample(1.0 / rate_Hz, method="bilinear")
    elif abs(float(system.dt) * rate_Hz - 1.0) > 1e-6 and system.dt is not True:
        raise BadLaw(f"the system was sampled every {system.dt:g} s", f"give rate_Hz={1.0 / system.dt:g}")
    A, B, C, D = (ca.DM(np.asarray(matrix)) for matrix in (system.A, system.B, system.C, system.D))
    names = [f"x{k}" for k in range(system.nstates)]

    @control_law(
        rate_Hz=rate_Hz, name=name, states=dict.fromkeys(names, 0.0), parameters={"hover_V": hover_V}
    )
    def law(now: Any, state: Any, parameter: Any) -> Command:
        """Take one step of the state space: compute voltages and new states."""
        x = column_of([getattr(state, key) for key in names])
        errors = _tracking_errors(now)
        command_V = ca.mtimes(C, x) + ca.mtimes(D, errors)
        next_x = ca.mtimes(A, x) + ca.mtimes(B, errors)
        front_V, back_V = motor_volts(parameter.hover_V + command_V[0], command_V[1], dead_zone_V)
        return Command(front_V, back_V, states={key: next_x[k] for k, key in enumerate(names)})

    return law


def from_function(
    function: ca.Function,
    *,
    rate_Hz: float = 1000.0,
    states: Sequence[float] = (),
    parameters: Mapping[str, float] | None = None,
    name: str | None = None,
) -> Law:
    """Make a law from a CasADi function.

    Parameters
    ----------
    function : casadi.Function
        Function of inputs (17, as ``LAW_INPUTS``), states (n) and parameters (m). It returns two voltages [V]
        and new states (n). The states and parameters, and the new states, may be missing.
    rate_Hz : float
        Calls per second [Hz].
    states : sequence of float
        Initial values of the states.
    parameters : mapping of str to float, optional
        Names and values of the parameters.
    name : str, optional
        Name of the law for readers; the function's name by default.

    Raises
    ------
    BadLaw
        The function has other arguments or results.
    """
    values = dict(parameters or {})
    expected_sizes = [len(LAW_INPUTS), len(states), len(values)]
    sizes = [function.numel_in(k) for k in range(function.n_in())]
    output_sizes = [function.numel_out(k) for k in range(function.n_out())]
    # States and parameters may be missing among the arguments if the law has none.
    are_arguments_right = sizes == expected_sizes[: len(sizes)] and not any(expected_sizes[len(sizes) :])
    are_results_right = output_sizes == [2, len(states)] or (output_sizes == [2] and not states)
    if not are_arguments_right or not are_results_right:
        raise BadLaw(
            f"the function {function.name()} takes {sizes} and gives {output_sizes} numbers",
            f"write it with {expected_sizes} arguments (inputs, states, parameters) "
            f"and results [2, {len(states)}] (voltages, states)",
        )
    names = [f"x{k}" for k in range(len(states))]
    initial = dict(zip(names, states, strict=True))

    @control_law(rate_Hz=rate_Hz, name=name or function.name(), states=initial, parameters=values)
    def law(now: Any, state: Any, parameter: Any) -> Command:
        """Call the CasADi function with columns of symbols."""
        arguments = [
            column_of([getattr(symbols, key) for key in keys])
            for symbols, keys in ((now, LAW_INPUTS), (state, names), (parameter, values))
        ]
        results = function.call(arguments[: len(sizes)])
        volts = results[0]
        new_states = {key: results[1][k] for k, key in enumerate(names)} if names else {}
        return Command(volts[0], volts[1], states=new_states)

    return law
