"""Input of every kernel: rates, measurement and Jacobians of a model, and voltages of the windows."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np
from heli_host.data.arrays import Floats, Integers
from heli_sim.model.base import Model


@dataclass(frozen=True)
class VoltageDerivative:
    """Derivatives of the voltages to a parameter that changes them before they act, such as a delay."""

    parameter: str  # Name of the parameter
    of_mean: Floats  # of_mean, of_change: (n, 2): Derivatives of `Inputs.mean_V` and of `Inputs.change_V`
    of_change: Floats


@dataclass(frozen=True)
class Inputs:
    """Inputs of the windows, one row per step; the rows of the windows are consecutive.

    Within a step each voltage is a straight line, given by its mean and its change over the step. A step as
    long as the flight's sample has no change. A longer step keeps the first and the second integral of the
    voltage, so that speeds and angles are the same as with the voltages sample by sample.
    """

    steps: Integers  # (w,): Number of steps of each window
    start_s: Floats  # (w,): Time of each window's first sample since the flight's first
    step_s: float  # Length of a step
    mean_V: Floats  # (n, 2): Mean front and back voltage over each step
    change_V: Floats  # (n, 2): Change of the voltages from the beginning to the end of each step
    substeps: int = 1  # Runge-Kutta steps in each step
    voltage_derivatives: tuple[VoltageDerivative, ...] = ()
    """One for each parameter that changes the voltages before they act."""

    @property
    def first(self) -> Integers:
        """Row of each window's first step, shape (w,)."""
        return np.concatenate(([0], np.cumsum(self.steps)[:-1])).astype(np.int64)

    @property
    def rows(self) -> int:
        """Number of steps of all windows."""
        return int(self.steps.sum())


class Functions:
    """Rates, measured angles and reset map of a model as CasADi functions, each also with its Jacobians.

    All take the state x, the inputs u, the time t and the parameters p.
    """

    def __init__(self, model: Model, free: tuple[str, ...]) -> None:
        names = model.parameter_names
        self.state_count = len(model.states)
        self.free_index = [names.index(name) for name in free]
        self.free = free
        self.voltage_parameters = tuple(name for name in (model.delay, "dead_zone") if name in free)
        """Free parameters to which the voltages may have derivatives, see `Inputs.voltage_derivatives`."""
        x, u = ca.SX.sym("x", self.state_count), ca.SX.sym("u", 2)
        t, p = ca.SX.sym("t"), ca.SX.sym("p", len(names))
        rates = ca.densify(model.dynamics(x, u, p, t))
        angles = ca.densify(model.measurement(x, u, p, t))
        to_free = [p[i] for i in self.free_index]
        # The number 10 is the depth to which CasADi compares expressions.
        self.angles_are_states = bool(ca.is_equal(angles, x[:3], 10))

        def with_derivatives(value: ca.SX) -> list[ca.SX]:
            """List a value and its Jacobians to the state, to the free parameters and to the inputs."""
            by_free = ca.jacobian(value, ca.vertcat(*to_free)) if to_free else ca.SX(value.numel(), 0)
            return [value, ca.jacobian(value, x), by_free, ca.jacobian(value, u)]

        def function(name: str, results: list[ca.SX]) -> ca.Function:
            """Compile a function that computes common subexpressions of its results once."""
            return ca.Function(name, [x, u, t, p], ca.cse(results))

        self.rates = function("heli_rates", [rates])
        self.rates_jacobian = function("heli_rates_jacobian", with_derivatives(rates))
        self.angles = function("heli_angles", [angles])
        self.angles_jacobian = function("heli_angles_jacobian", with_derivatives(angles))
        reset_map = ca.densify(model.reset_map(x, u, p, t))
        self.has_reset = not ca.is_equal(reset_map, x, 10)
        """Whether a reset map acts on the state after each step."""
        self.reset_map = function("heli_reset_map", [reset_map])
        self.reset_map_jacobian = function("heli_reset_map_jacobian", with_derivatives(reset_map))

    @property
    def all(self) -> tuple[ca.Function, ...]:
        """Every function that a kernel calls."""
        always = (self.rates, self.rates_jacobian, self.angles, self.angles_jacobian)
        return (*always, self.reset_map, self.reset_map_jacobian) if self.has_reset else always
