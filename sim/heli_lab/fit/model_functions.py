"""Equations of a grey-box model with their derivatives, evaluated in each step of a trajectory."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import casadi as ca
import numpy as np
from heli_host.data.arrays import Floats
from heli_sim.evaluate.trajectories import AlongTrajectory, EffectStates, Trajectory

from heli_lab.fit.grey_box import GreyBoxModel


class ModelDerivatives(NamedTuple):
    """Rates and outputs of a model at n points of a trajectory, with their derivatives."""

    rates: Floats
    """(n, states, 1 + f): Column 0 holds the rates, the others their negative derivatives by the free
    parameters."""
    by_state: Floats  # by_state, by_disturbance, by_input: (n, states, k): Derivatives of the rates
    by_disturbance: Floats
    by_input: Floats
    outputs: Floats
    """(n, m, 1 + f): Column 0 holds the outputs, the others their derivatives by the free parameters."""
    outputs_by_state: Floats  # (n, m, states): Derivatives of the outputs


class ModelFunctions:
    """Compiled rates and outputs of a model, with their derivatives by state, parameters and disturbances.

    Parameters
    ----------
    model : GreyBoxModel
        The model whose equations are compiled.
    free : sequence of str
        Parameters by which derivatives are taken.

    Attributes
    ----------
    names : tuple of str
        All parameters of the model.
    places : list of int
        Indices of the free parameters in `names`.
    extra_states : int
        Number of states beyond positions and rates.
    """

    def __init__(self, model: GreyBoxModel, free: Sequence[str]) -> None:
        self.model, self.free, self.names = model, tuple(free), model.parameters
        self.places = [model.parameters.index(name) for name in free]
        disturbed = [model.parameters.index(name) for name in model.disturbed]
        # Symbols: state x, inputs u, parameters p, time t.
        x, u = ca.SX.sym("x", len(model.states)), ca.SX.sym("u", len(model.inputs))
        p, t = ca.SX.sym("p", len(model.parameters)), ca.SX.sym("t")
        rates, outputs = model.dynamics(x, u, p, t), model.measurement(x, u, p, t)

        def by_free(value: ca.SX) -> ca.SX:
            """Jacobian of a column vector by the free parameters; without any, it has no columns."""
            if not self.places:
                return ca.SX(value.numel(), 0)
            return ca.jacobian(value, ca.vertcat(*(p[i] for i in self.places)))

        # These are the fields of ModelDerivatives. With the opposite sign of the derivatives, the filter
        # gives the reduction of the innovations per unit of a parameter.
        results = [
            ca.horzcat(rates, -by_free(rates)),
            ca.jacobian(rates, x),
            ca.jacobian(rates, ca.vertcat(*(p[i] for i in disturbed))),
            ca.jacobian(rates, u),
            ca.horzcat(outputs, by_free(outputs)),
            ca.jacobian(outputs, x),
        ]
        self._along = AlongTrajectory(
            ca.Function("along", [x, u, t, p], [ca.densify(result) for result in results])
        )
        self.extra_states = model.extra_states
        if self.extra_states:
            # y: positions and rates of the reference trajectory; z: the states that are integrated along it.
            z, y = ca.SX.sym("z", self.extra_states), ca.SX.sym("y", model.followed)
            state, arguments = ca.vertcat(y, z), [z, t, y, u, p]
            extra = slice(model.followed, None)
            self._integrator = EffectStates(
                ca.Function("rates", arguments, [ca.densify(model.dynamics(state, u, p, t)[extra])]),
                ca.Function("resets", arguments, [ca.densify(model.reset_map(state, u, p, t)[extra])]),
            )

    def __reduce__(self) -> tuple[type[ModelFunctions], tuple[GreyBoxModel, tuple[str, ...]]]:
        """Pickle the arguments only, because compiled programs cannot be pickled."""
        return ModelFunctions, (self.model, self.free)

    def along(self, trajectory: Trajectory) -> ModelDerivatives:
        """Evaluate the model at each point of a trajectory."""
        return ModelDerivatives(*self._along(trajectory))

    def integrate(self, trajectory: Trajectory, directions: Floats) -> Floats:
        """Integrate the extra states along a trajectory of positions and rates, from zero.

        Parameters
        ----------
        trajectory : Trajectory
            Middle of each step.
        directions : ndarray (n, m)
            Direction in which each output moved last, at the beginning of each step.

        Returns
        -------
        ndarray (n + 1, extra states)
            States at the beginning of each step, and at the end of the last.
        """
        positions_and_rates = trajectory.state[:, : self.model.followed]
        ends = self._integrator.integrate(replace(trajectory, state=positions_and_rates))
        states: Floats = np.vstack((np.zeros(self.extra_states), ends))
        for column, output in self.model.known_directions:
            states[:, column] = np.append(directions[:, output], directions[-1, output])
        return states
