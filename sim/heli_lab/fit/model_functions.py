"""Equations of a grey-box model with their derivatives, evaluated in each step of a trajectory.

A CasADi function is a list of elementary operations. CasADi's own interpreter runs the list for one step at a
time. The interpreter used here carries out each operation for many steps together, which is several times
faster and needs no compiler.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import casadi as ca
import numpy as np
from heli_host.data.arrays import Floats

from heli_lab.errors import IdentifyError
from heli_lab.fit import _expression_vm
from heli_lab.fit.grey_box import GreyBoxModel

_BY_CASADI: Final = {
    getattr(ca, f"OP_{name}"): number for number, name in enumerate(_expression_vm.OPERATIONS)
}
_INPUT: Final = _expression_vm.OPERATIONS.index("INPUT")
_CONST: Final = _expression_vm.OPERATIONS.index("CONST")

EFFECT_SUBSTEPS: Final = 4
"""Runge-Kutta steps of the extra states in each step of 10 ms: lags of a few milliseconds stay stable."""


@dataclass(frozen=True)
class Trajectory:
    """States and inputs at one time in each step of a flight.

    Parameters
    ----------
    t_s : ndarray (n,)
        Time in each step since the flight's first sample, such as its middle.
    state : ndarray (n, states)
        State at that time.
    inputs : ndarray (n, inputs)
        Mean inputs over the step, as they act.
    step_s : float
        Length of a step.
    parameters : ndarray (p,)
        All parameters of the model.
    """

    t_s: Floats
    state: Floats
    inputs: Floats
    step_s: float
    parameters: Floats

    def part(self, rows: slice) -> Trajectory:
        """Keep the steps `rows`."""
        return replace(self, t_s=self.t_s[rows], state=self.state[rows], inputs=self.inputs[rows])


class _ExpressionList:
    """A CasADi function as a list of elementary operations, from which equal subexpressions are removed.

    The value of operation k depends on the values of earlier operations only, so that one pass over the list
    evaluates the function.
    """

    def __init__(self, function: ca.Function) -> None:
        self._input_sizes = [function.numel_in(i) for i in range(function.n_in())]
        self._index: dict[tuple[int, int, int, str], int] = {}
        """Index in the list of each operation.

        An operation has four parts: its code in `_expression_vm.OPERATIONS`, the indices of its two operands,
        and the value of a constant. For an input, the operands are the numbers of the input and of its
        element."""
        zero = self._add_operation(_CONST)
        self.outputs = [[zero] * function.numel_out(i) for i in range(function.n_out())]
        in_register: dict[int, int] = {}
        """Operation whose value is in each of CasADi's work registers."""
        for k in range(function.n_instructions()):
            code = function.instruction_id(k)
            target, operands = function.instruction_output(k), function.instruction_input(k)
            if code == ca.OP_OUTPUT:
                number, element = target
                rows, columns = function.size_out(number)
                # CasADi counts down the columns, numpy along the rows.
                row, column = element % rows, element // rows
                self.outputs[number][row * columns + column] = in_register[operands[0]]
            elif code == ca.OP_INPUT:
                in_register[target[0]] = self._add_operation(_INPUT, operands[0], operands[1])
            elif code == ca.OP_CONST:
                in_register[target[0]] = self._add_operation(
                    _CONST, constant=function.instruction_constant(k)
                )
            else:
                if code not in _BY_CASADI:
                    raise IdentifyError(
                        f"a model uses CasADi's operation {code}, which is not evaluated here",
                        "write it with arithmetic, comparisons and elementary functions",
                    )
                # The second operand of a unary operation is ignored.
                first, second = in_register[operands[0]], in_register[operands[-1]]
                in_register[target[0]] = self._add_operation(_BY_CASADI[code], first, second)

    def _add_operation(self, operation: int, first: int = 0, second: int = 0, constant: float = 0.0) -> int:
        """Append an operation unless the list has the same one; return its index in the list."""
        # Derivatives repeat subexpressions many times; `ca.cse` takes 9 ms per model to find them.
        # A constant is compared as text: -0 differs from 0, and nan equals nan.
        key = (operation, first, second, constant.hex())
        return self._index.setdefault(key, len(self._index))

    @property
    def arguments(self) -> tuple[list[int], list[int], list[int], list[float], list[int]]:
        """Leading arguments of the constructors in `_expression_vm`."""
        operations, first_operands, second_operands, texts = map(list, zip(*self._index, strict=True))
        constants = [float.fromhex(text) for text in texts]
        return operations, first_operands, second_operands, constants, self._input_sizes


def _as_row_table(values: Floats) -> Floats:
    """Return `values`, shape (n,) or (n, k), as a contiguous array of shape (n, k)."""
    table: Floats = np.ascontiguousarray(values, float)
    return table[:, None] if table.ndim == 1 else table


class AlongTrajectory:
    """A compiled function that is evaluated in each step of a trajectory.

    Parameters
    ----------
    function : casadi.Function
        Function of state, inputs, time and all parameters, with dense arguments and results.
    """

    def __init__(self, function: ca.Function) -> None:
        self._function = function
        expressions = _ExpressionList(function)
        self._shapes = [function.size_out(i) for i in range(function.n_out())]
        self._program = _expression_vm.TableProgram(*expressions.arguments, expressions.outputs)

    def __reduce__(self) -> tuple[type[AlongTrajectory], tuple[ca.Function]]:
        """Pickle the function only, because compiled programs cannot be pickled."""
        return AlongTrajectory, (self._function,)

    def __call__(self, trajectory: Trajectory) -> list[Floats]:
        """Evaluate the function: one array per output, shape (n, rows, columns)."""
        inputs = [_as_row_table(array) for array in (trajectory.state, trajectory.inputs, trajectory.t_s)]
        values = self._program.evaluate(inputs, np.ascontiguousarray(trajectory.parameters, float))
        return [
            table.reshape(len(table), rows, columns)
            for table, (rows, columns) in zip(values, self._shapes, strict=True)
        ]


class EffectStates:
    """Integrates the states z of effects along a given trajectory of the other states.

    Parameters
    ----------
    rates, resets : casadi.Function
        Rates of z, and z after the jump at the end of a step; functions of z, time, state and inputs of the
        trajectory, and all parameters.
    """

    def __init__(self, rates: ca.Function, resets: ca.Function) -> None:
        self._functions = rates, resets
        arguments = [ca.SX.sym("v", rates.numel_in(i)) for i in range(rates.n_in())]
        both = ca.Function("both", arguments, [rates(*arguments), resets(*arguments)])
        expressions = _ExpressionList(both)
        self._size = both.numel_in(0)
        self._integrator = _expression_vm.CourseIntegrator(*expressions.arguments, *expressions.outputs)

    def __reduce__(self) -> tuple[type[EffectStates], tuple[ca.Function, ca.Function]]:
        """Pickle the functions only, because compiled programs cannot be pickled."""
        return EffectStates, self._functions

    def integrate(self, trajectory: Trajectory, returned_substep: int = EFFECT_SUBSTEPS - 1) -> Floats:
        """Integrate from z = 0 with `EFFECT_SUBSTEPS` Runge-Kutta steps in each step.

        Parameters
        ----------
        trajectory : Trajectory
            Middle of each step.
        returned_substep : int
            The substep at whose end z is returned; by default the last.

        Returns
        -------
        ndarray (n, z)
            States z in each step.
        """
        states: Floats = self._integrator.run(
            [_as_row_table(array) for array in (trajectory.state, trajectory.inputs)],
            np.ascontiguousarray(trajectory.t_s, float),
            np.ascontiguousarray(trajectory.parameters, float),
            trajectory.step_s,
            EFFECT_SUBSTEPS,
            returned_substep,
            np.zeros(self._size),
        )
        return states


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
    along : AlongTrajectory
        Function of n points of a trajectory, with six results. The first four are the rates with their
        negative derivatives by the free parameters, (n, states, 1 + f), and the derivatives of the rates by
        state, disturbances and inputs, (n, states, k) each. The last two are the outputs with their
        derivatives by the free parameters, (n, m, 1 + f), and those by the state, (n, m, states).
    extra_states : int
        Number of states beyond positions and rates.
    """

    def __init__(self, model: GreyBoxModel, free: Sequence[str]) -> None:
        self.model, self.free, self.names = model, tuple(free), model.parameters
        self.places = [model.parameters.index(name) for name in free]
        disturbed = [model.parameters.index(name) for name in model.disturbed]
        x, u = ca.SX.sym("x", len(model.states)), ca.SX.sym("u", len(model.inputs))
        p, t = ca.SX.sym("p", len(model.parameters)), ca.SX.sym("t")
        rates, outputs = model.dynamics(x, u, p, t), model.measurement(x, u, p, t)

        def by_free(value: ca.SX) -> ca.SX:
            """Jacobian of a column vector by the free parameters; without any, it has no columns."""
            if not self.places:
                return ca.SX(value.numel(), 0)
            return ca.jacobian(value, ca.vertcat(*(p[i] for i in self.places)))

        # With the opposite sign, the filter gives the reduction of the innovations per unit of a parameter.
        results = [
            ca.horzcat(rates, -by_free(rates)),
            ca.jacobian(rates, x),
            ca.jacobian(rates, ca.vertcat(*(p[i] for i in disturbed))),
            ca.jacobian(rates, u),
            ca.horzcat(outputs, by_free(outputs)),
            ca.jacobian(outputs, x),
        ]
        self.along = AlongTrajectory(
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
