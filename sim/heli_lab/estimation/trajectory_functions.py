"""Functions of state, inputs, time and parameters, evaluated in each step of a trajectory.

CasADi's expressions are straight-line programs. Its own interpreter evaluates them one row at a time; this
one carries out each operation for many rows, which is several times faster and needs no compiler.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import casadi as ca
import numpy as np
from heli_host.arrays import Floats

from heli_lab.errors import IdentifyError
from heli_lab.estimation import _expression_vm

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


class _Listing:
    """Values of a CasADi `function` of dense inputs and outputs, each computed once.

    Raises
    ------
    IdentifyError
        When it has an operation that programs lack.
    """

    def __init__(self, function: ca.Function) -> None:
        self.widths = [function.numel_in(i) for i in range(function.n_in())]
        self.operations: list[int] = []
        self.a: list[int] = []
        self.b: list[int] = []
        self.constants: list[float] = []
        self._known: dict[tuple[int, int, int, str], int] = {}
        zero = self._add(_CONST)
        self.outputs = [[zero] * function.numel_out(i) for i in range(function.n_out())]
        held: dict[int, int] = {}
        for k in range(function.n_instructions()):
            code = function.instruction_id(k)
            to, read = function.instruction_output(k), function.instruction_input(k)
            if code == ca.OP_OUTPUT:
                number, element = to
                rows, columns = function.size_out(number)
                # CasADi counts down the columns, numpy along the rows.
                place = element % rows * columns + element // rows
                self.outputs[number][place] = held[read[0]]
            elif code == ca.OP_INPUT:
                held[to[0]] = self._add(_INPUT, read[0], read[1])
            elif code == ca.OP_CONST:
                held[to[0]] = self._add(_CONST, constant=function.instruction_constant(k))
            else:
                if code not in _BY_CASADI:
                    raise IdentifyError(
                        f"a model uses CasADi's operation {code}, which is not evaluated here",
                        "write it with arithmetic, comparisons and elementary functions",
                    )
                first = held[read[0]]
                held[to[0]] = self._add(_BY_CASADI[code], first, held[read[1]] if len(read) > 1 else first)

    def _add(self, operation: int, a: int = 0, b: int = 0, constant: float = 0.0) -> int:
        # Derivatives hold the same subexpression many times; to have `ca.cse` find them takes 9 ms a model.
        # As text -0 is not 0, and no number is itself.
        key = (operation, a, b, constant.hex() if operation == _CONST else "")
        place = self._known.setdefault(key, len(self.operations))
        if place == len(self.operations):
            self.operations.append(operation)
            self.a.append(a)
            self.b.append(b)
            self.constants.append(constant)
        return place

    @property
    def arguments(self) -> tuple[list[int], list[int], list[int], list[float], list[int]]:
        """Arguments in the order of the programs."""
        return self.operations, self.a, self.b, self.constants, self.widths


def _table(values: Floats) -> Floats:
    table: Floats = np.ascontiguousarray(values, float)
    return table[:, None] if table.ndim == 1 else table


class AlongTrajectory:
    """Evaluates a `function` of state, inputs, time and all parameters in each step of a trajectory; its
    arguments and results are dense.
    """

    def __init__(self, function: ca.Function) -> None:
        self._function = function
        listing = _Listing(function)
        self._shapes = [function.size_out(i) for i in range(function.n_out())]
        self._program = _expression_vm.TableProgram(*listing.arguments, listing.outputs)

    def __reduce__(self) -> tuple[type[AlongTrajectory], tuple[ca.Function]]:
        # Programs are compiled in; they are made again.
        return AlongTrajectory, (self._function,)

    def __call__(self, trajectory: Trajectory) -> list[Floats]:
        """Evaluate the function: one array per output, shape (n, rows, columns)."""
        inputs = [_table(array) for array in (trajectory.state, trajectory.inputs, trajectory.t_s)]
        values = self._program.evaluate(inputs, np.ascontiguousarray(trajectory.parameters, float))
        return [
            table.reshape(len(table), rows, columns)
            for table, (rows, columns) in zip(values, self._shapes, strict=True)
        ]


class EffectStates:
    """Integrates extra states along a reference trajectory that they do not change.

    Parameters
    ----------
    rates, resets : casadi.Function
        Their rates, and what they jump to at the end of a step, by z, time, the `inputs` of a step and all
        parameters.
    """

    def __init__(self, rates: ca.Function, resets: ca.Function) -> None:
        self._made_of = rates, resets
        arguments = [ca.SX.sym("v", rates.numel_in(i)) for i in range(rates.n_in())]
        both = ca.Function("both", arguments, [rates(*arguments), resets(*arguments)])
        listing = _Listing(both)
        self._size = both.numel_in(0)
        self._integrator = _expression_vm.CourseIntegrator(*listing.arguments, *listing.outputs)

    def __reduce__(self) -> tuple[type[EffectStates], tuple[ca.Function, ca.Function]]:
        return EffectStates, self._made_of

    def integrate(
        self,
        reference: Sequence[Floats],
        t_s: Floats,
        parameters: Floats,
        step_s: float,
        substeps: int,
        seen: int | None = None,
    ) -> Floats:
        """Integrate from rest, z = 0.

        Parameters
        ----------
        reference : sequence of ndarray (n, width)
            Inputs of each step.
        t_s : ndarray (n,)
            Middle of each step.
        parameters : ndarray (p,)
            All parameters.
        step_s : float
            Length of a step.
        substeps : int
            Runge-Kutta steps in each.
        seen : int, optional
            The substep at whose end z is returned; the last unless given.

        Returns
        -------
        ndarray (n, z)
        """
        states: Floats = self._integrator.run(
            [_table(array) for array in reference],
            np.ascontiguousarray(t_s, float),
            np.ascontiguousarray(parameters, float),
            step_s,
            substeps,
            substeps - 1 if seen is None else seen,
            np.zeros(self._size),
        )
        return states
