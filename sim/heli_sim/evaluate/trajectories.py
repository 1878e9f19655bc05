"""Functions of CasADi evaluated in each step of a trajectory, by an interpreter in C++.

A CasADi function is a list of elementary operations. CasADi's own interpreter runs the list for one step at a
time. `_expression_vm` carries out each operation for many steps together, which is several times faster and
needs no compiler.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import casadi as ca
import numpy as np
from heli_host.data.arrays import Floats

from heli_sim.errors import PlantError
from heli_sim.evaluate import _expression_vm

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
    """A CasADi function as a list of elementary operations, from which equal subexpressions are removed."""

    # The value of operation k depends on the values of earlier operations only, so that one pass over the
    # list evaluates the function.

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
                    raise PlantError(
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
