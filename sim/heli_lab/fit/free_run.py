"""Free runs of a model over many windows, with exact derivatives: the inner loop of every fit.

A kernel simulates all windows, and propagates the state with its sensitivities to the window's initial state
and to the free parameters. There are two. The compiled kernel has the rates of the state and their Jacobians
as C, and the loop of fourth-order Runge-Kutta steps of `windows.c` around them; its library is kept in the
user's cache. Without a C compiler, the interpreted kernel runs the same loop in NumPy. The compiled one takes
11 ms for 20 windows of 2 s with 21 free parameters (2026-11). The interpreted one takes longer even without
sensitivities: 13 to 31 ms.
"""

from __future__ import annotations

import ctypes
import functools
import itertools
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import casadi as ca
import numpy as np
from heli_host.data.arrays import Floats, Integers
from heli_sim.errors import PlantError
from heli_sim.evaluate.compiled import compile_source
from heli_sim.evaluate.lanes import c_function
from heli_sim.evaluate.trajectories import AlongTrajectory, Trajectory
from heli_sim.model.base import Model
from typing_extensions import override

from heli_lab.threads import default_thread_count, parallel_map


@dataclass(frozen=True)
class VoltageDerivative:
    """Derivatives of the voltages to a parameter that changes them before they act, such as a delay."""

    parameter: str  # Name of the parameter
    of_mean: Floats  # of_mean, of_change: (n, 2): Derivatives of `Inputs.mean_V` and of `Inputs.change_V`
    of_change: Floats


@dataclass(frozen=True)
class Inputs:
    """Inputs of the windows, one row per step; the rows of the windows are consecutive."""

    # Within a step each voltage is a straight line, given by its mean and its change over the step. A step as
    # long as the flight's sample has no change. A longer step keeps the first and the second integral of the
    # voltage, so that speeds and angles are the same as with the voltages sample by sample.

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


_COMPARISON_DEPTH: Final = 10
"""Depth to which CasADi compares expressions: two that differ only below count as different."""


class Functions:
    """Rates, measured angles and reset map of a model as CasADi functions, each also with its Jacobians."""

    # All take the state x, the inputs u, the time t and the parameters p.

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
        positions = x[:3]
        self.angles_are_states = bool(ca.is_equal(angles, positions, _COMPARISON_DEPTH))

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
        self.has_reset = not ca.is_equal(reset_map, x, _COMPARISON_DEPTH)
        """Whether a reset map acts on the state after each step."""
        self.reset_map = function("heli_reset_map", [reset_map])
        self.reset_map_jacobian = function("heli_reset_map_jacobian", with_derivatives(reset_map))

    @property
    def all(self) -> tuple[ca.Function, ...]:
        """Every function that a kernel calls."""
        always = (self.rates, self.rates_jacobian, self.angles, self.angles_jacobian)
        return (*always, self.reset_map, self.reset_map_jacobian) if self.has_reset else always


class Kernel(ABC):
    """Simulates w windows, which have n steps in total. Compiled and interpreted kernels agree to the
    rounding of doubles.
    """

    @abstractmethod
    def predict(self, inputs: Inputs, start: Floats, parameters: Floats) -> tuple[Floats, Floats]:
        """Simulate every window from its initial state. Shapes: `start` (w, states), `parameters` (p,);
        returns `angles_rad` (n, 3), `end` (w, states).
        """

    @abstractmethod
    def jacobian(self, inputs: Inputs, start: Floats, parameters: Floats) -> tuple[Floats, Floats]:
        """Simulate as `predict` does, with derivatives. Returns shape `angles_rad` (n, 3), `jacobian` (n, 3,
        states + free).
        """

    @abstractmethod
    def products(
        self, inputs: Inputs, start: Floats, parameters: Floats, measured_rad: Floats, sigma_rad: Floats
    ) -> tuple[Floats, Floats]:
        """Simulate as `predict` does, and sum the products that the normal equations need. Shapes:
        `measured_rad` (n, 3), `sigma_rad` (3,); returns `angles_rad` (n, 3), `normal_matrix` (w, 3, states +
        free + 1, states + free + 1).
        """


_WORTH_THREADS_ROWS: Final = 500
"""Steps from which on a second thread saves more than it costs to start."""

LOOP: Final = Path(__file__).with_name("windows.c")
"""The loop around these functions; its head describes the macros that it needs."""
_FUNCTIONS: Final = "/* The functions of the model end here. */"
"""Line of the loop before which these functions are inserted."""


def _chain_rule_macro(functions: Functions, function: ca.Function) -> str:
    """Write the chain rule for the sensitivities of a function in C, as the body of a macro."""
    # The sensitivities are out = fx s + fp + fu du: the Jacobians fx, fp and fu to state, free parameters and
    # voltages, the sensitivities s of the state, and the derivatives du of the voltages. Elements that are
    # always zero are left out.
    lines = []
    # In C, fx, fp and fu hold the nonzeros of the Jacobians to state, free parameters and voltages. The
    # sensitivities of the state are s, those of the voltages du.
    fx = _nonzeros(function.sparsity_out(1))
    for row in range(function.size1_out(0)):
        terms = [f"fx[{k}] * s[{j}][z]" for k, (i, j) in enumerate(fx) if i == row]
        lines.append(f"for (int z = 0; z < NZ; ++z) out[{row}][z] = {' + '.join(terms) or 'all(0.0)'};")
    for k, (i, j) in enumerate(_nonzeros(function.sparsity_out(2))):
        lines.append(f"out[{i}][{functions.state_count + j}] += fp[{k}];")
    for number, name in enumerate(functions.voltage_parameters):
        column = functions.state_count + functions.free.index(name)
        for k, (i, j) in enumerate(_nonzeros(function.sparsity_out(3))):
            lines.append(f"out[{i}][{column}] += fu[{k}] * du[{number}][{j}];")
    return " \\\n  ".join(["(void)fp, (void)fu, (void)du;", *lines])


def _nonzeros(sparsity: ca.Sparsity) -> list[tuple[int, int]]:
    """Row and column of each element of a sparse matrix, in the order in which CasADi stores them."""
    rows, columns = sparsity.get_triplet()
    return list(zip(rows, columns, strict=True))


def kernel_source(functions: Functions) -> str:
    """Write the kernel: one C file with the function heli_windows."""
    jacobians = (functions.rates_jacobian, functions.angles_jacobian, functions.reset_map_jacobian)
    # Outputs 1, 2 and 3 are the Jacobians to the state, to the free parameters and to the voltages.
    nonzeros = [max(1, *(function.nnz_out(output) for function in jacobians)) for output in (1, 2, 3)]
    macros = {
        "NX": functions.state_count,
        "NZ": functions.state_count + len(functions.free_index),
        "NS": max(1, len(functions.voltage_parameters)),
        "SIZE_FX": nonzeros[0],
        "SIZE_FP": nonzeros[1],
        "SIZE_FU": nonzeros[2],
        "ANGLES_ARE_STATES": int(functions.angles_are_states),
        "HAS_RESET": int(functions.has_reset),
        "CHAIN_RATES": _chain_rule_macro(functions, functions.rates_jacobian),
        "CHAIN_ANGLES": _chain_rule_macro(functions, functions.angles_jacobian),
        "CHAIN_RESET_MAP": _chain_rule_macro(functions, functions.reset_map_jacobian),
    }
    loop = LOOP.read_text(encoding="utf-8")
    before, mark, after = loop.partition(_FUNCTIONS)
    defines = "".join(f"#define {name} {value}\n" for name, value in macros.items())
    model_functions = "\n".join(c_function(function) for function in functions.all)
    return "".join((defines, before, model_functions, mark, after))


def _row_address(array: Floats | Integers | None, row: int = 0) -> ctypes.c_void_p | None:
    """Address of a row of an array, for a call of C; null without an array."""
    return None if array is None else ctypes.c_void_p(array[row:].ctypes.data)


def _balanced_edges(steps: Integers, parts: int) -> list[int]:
    """Divide windows into up to `parts` parts of consecutive windows and about the same number of steps;
    return the first window of each part, then the number of windows. Shapes: `steps` (w,).
    """
    windows, steps_until_end = len(steps), np.cumsum(steps)
    ideal_steps = steps_until_end[-1] * np.arange(1, parts) / parts
    # A part ends after the window that contains its ideal last step. Two parts that would end at the same
    # window become one.
    inner = np.unique(np.searchsorted(steps_until_end, ideal_steps) + 1)
    return [0, *(int(edge) for edge in inner if edge < windows), windows]


@dataclass(frozen=True)
class _NormalMatrices:
    """Normal matrices to be filled, with what their residuals need."""

    measured_rad: Floats  # (n, 3): Measured angles
    sigma_rad: Floats  # (3,): Unit of the residuals
    result: Floats  # (w, 3, states + f + 1, states + f + 1): As in `Kernel.products`; filled by the call


class CompiledKernel(Kernel):
    """Simulates the windows with compiled code."""

    def __init__(self, functions: Functions, library: str, threads: int = 1) -> None:
        self._threads = threads
        self._state_count = functions.state_count
        self._column_count = functions.state_count + len(functions.free_index)
        self._voltage_parameters = functions.voltage_parameters
        try:
            self._windows: Callable[..., None] = ctypes.CDLL(library).heli_windows
        except (OSError, AttributeError) as error:
            raise PlantError(f"the compiled model does not load: {error}", f"delete {library}") from None
        self._windows.restype = None

    @override
    def predict(self, inputs: Inputs, start: Floats, parameters: Floats) -> tuple[Floats, Floats]:
        return self._run_in_c(inputs, start, parameters)

    @override
    def jacobian(self, inputs: Inputs, start: Floats, parameters: Floats) -> tuple[Floats, Floats]:
        jacobian = np.empty((inputs.rows, 3, self._column_count))
        angles, _ = self._run_in_c(inputs, start, parameters, jacobian=jacobian)
        return angles, jacobian

    @override
    def products(
        self, inputs: Inputs, start: Floats, parameters: Floats, measured_rad: Floats, sigma_rad: Floats
    ) -> tuple[Floats, Floats]:
        size = self._column_count + 1
        products = _NormalMatrices(
            np.ascontiguousarray(measured_rad, float),
            np.ascontiguousarray(sigma_rad, float),
            np.zeros((len(inputs.steps), 3, size, size)),
        )
        angles, _ = self._run_in_c(inputs, start, parameters, products=products)
        return angles, products.result

    def _run_in_c(
        self,
        inputs: Inputs,
        start: Floats,
        parameters: Floats,
        *,
        jacobian: Floats | None = None,
        products: _NormalMatrices | None = None,
    ) -> tuple[Floats, Floats]:
        """Simulate every window in C, and fill the arrays that are given. Shapes: `jacobian` (n, 3, states +
        f); returns `angles_rad` (n, 3), `end` (w, states).
        """
        # n: rows of all windows; w: windows; f: free parameters.
        windows = len(inputs.steps)
        angles = np.empty((inputs.rows, 3))
        end = np.empty((windows, self._state_count))
        # C reads rows without gaps.
        arrays = (inputs.mean_V, inputs.change_V, inputs.start_s, start, parameters)
        mean_V, change_V, start_s, start_state, all_parameters = (
            np.ascontiguousarray(array, float) for array in arrays
        )
        # These dictionaries also keep the arrays alive while C has their addresses.
        of_mean = {by.parameter: np.ascontiguousarray(by.of_mean) for by in inputs.voltage_derivatives}
        of_change = {by.parameter: np.ascontiguousarray(by.of_change) for by in inputs.voltage_derivatives}
        mean_pointers, change_pointers = self._pointers(of_mean), self._pointers(of_change)
        first, steps = inputs.first, np.ascontiguousarray(inputs.steps, np.int64)

        def run_windows(low: int, high: int) -> None:
            """Run the windows `low` to `high` - 1 in C; the arguments are those of heli_windows. Arrays with
            one row per window begin at `low`.
            """
            self._windows(
                ctypes.c_longlong(high - low),
                _row_address(first, low),
                _row_address(steps, low),
                _row_address(start_s, low),
                ctypes.c_double(inputs.step_s),
                ctypes.c_longlong(inputs.substeps),
                _row_address(mean_V),
                _row_address(change_V),
                mean_pointers,
                change_pointers,
                _row_address(start_state, low),
                _row_address(all_parameters),
                _row_address(angles),
                _row_address(jacobian),
                _row_address(end, low),
                _row_address(products.measured_rad if products else None),
                _row_address(products.sigma_rad if products else None),
                _row_address(products.result if products else None, low),
            )

        # Python threads run in parallel here, because the call of C releases Python's global lock.
        if self._threads == 1 or windows < 2 or inputs.rows < _WORTH_THREADS_ROWS:
            run_windows(0, windows)
            return angles, end
        edges = _balanced_edges(steps, self._threads)
        parallel_map(lambda ends: run_windows(*ends), list(itertools.pairwise(edges)), self._threads)
        return angles, end

    def _pointers(self, arrays: dict[str, Floats]) -> ctypes.Array[ctypes.c_void_p]:
        """Addresses of `arrays`, by parameter, in the order of the voltage parameters; null for a parameter
        without an array.
        """
        addresses = [
            arrays[name].ctypes.data if name in arrays else None for name in self._voltage_parameters
        ]
        return (ctypes.c_void_p * max(1, len(addresses)))(*addresses)


@dataclass(frozen=True)
class _States:
    """States of some windows at one instant, with their sensitivities."""

    value: Floats  # (w, states): States
    sensitivity: Floats
    """(w, states, states + f): Derivatives of the states to the window's initial state and to the free
    parameters. The last axis has length 0 if no derivatives are computed."""

    def moved(self, rate: _States, time_s: float) -> _States:
        """Return the states after `time_s` [s] at a constant `rate`; sensitivities change likewise."""
        return _States(self.value + time_s * rate.value, self.sensitivity + time_s * rate.sensitivity)


class InterpretedKernel(Kernel):
    """Simulates all windows step by step in NumPy, with one array row per window."""

    def __init__(self, functions: Functions) -> None:
        self.functions = functions
        self._programs: dict[str, AlongTrajectory] = {}

    def program(self, name: str) -> AlongTrajectory:
        """Return the function `name` of the model with dense results, compiled for many windows together."""
        if name not in self._programs:
            function: ca.Function = getattr(self.functions, name)
            arguments = [ca.SX.sym("a", function.size1_in(i)) for i in range(function.n_in())]
            results = function.call(arguments)
            dense = ca.Function(name, arguments, [ca.densify(result) for result in results])
            self._programs[name] = AlongTrajectory(dense)
        return self._programs[name]

    @override
    def predict(self, inputs: Inputs, start: Floats, parameters: Floats) -> tuple[Floats, Floats]:
        angles, _, end = self._simulate(inputs, start, parameters, derivatives=False)
        return angles, end

    @override
    def jacobian(self, inputs: Inputs, start: Floats, parameters: Floats) -> tuple[Floats, Floats]:
        return self._simulate(inputs, start, parameters, derivatives=True)[:2]

    @override
    def products(
        self, inputs: Inputs, start: Floats, parameters: Floats, measured_rad: Floats, sigma_rad: Floats
    ) -> tuple[Floats, Floats]:
        angles, jacobian = self.jacobian(inputs, start, parameters)
        # Shape (n, 3, states + free + 1).
        columns = np.concatenate((jacobian, (measured_rad - angles)[:, :, None]), axis=2)
        columns /= sigma_rad[:, None]
        edges = np.append(inputs.first, inputs.rows)
        # Shape (3, steps, states + free + 1) for each window: a product of matrices for each axis.
        by_window = [columns[start:stop].transpose(1, 0, 2) for start, stop in itertools.pairwise(edges)]
        return angles, np.array([window.transpose(0, 2, 1) @ window for window in by_window])

    def _simulate(
        self, inputs: Inputs, start: Floats, parameters: Floats, derivatives: bool
    ) -> tuple[Floats, Floats, Floats]:
        """Simulate all windows step by step. Returns shape `angles_rad` (n, 3), `jacobian` (n, 3, states +
        f), `end` (w, states).
        """
        state_count = self.functions.state_count
        column_count = state_count + len(self.functions.free_index) if derivatives else 0
        angles = np.empty((inputs.rows, 3))
        jacobian = np.empty((inputs.rows, 3, column_count))
        value = np.array(start, float)
        sensitivity = np.zeros((len(inputs.steps), state_count, column_count))
        if derivatives:
            # By itself, the initial state has the identity as derivatives.
            sensitivity[:, range(state_count), range(state_count)] = 1.0
        for step in range(int(inputs.steps.max())):
            # Shorter windows have ended.
            running = np.flatnonzero(inputs.steps > step)
            rows = inputs.first[running] + step
            states = _States(value[running], sensitivity[running])
            start_s = inputs.start_s[running] + step * inputs.step_s
            this_step = _Step(self, inputs, rows, start_s, parameters)
            measured = this_step.evaluate("angles", 0.0, states)
            angles[rows], jacobian[rows] = measured.value, measured.sensitivity
            states = this_step.advance(states)
            value[running], sensitivity[running] = states.value, states.sensitivity
        return angles, jacobian, value


@dataclass(frozen=True)
class _Step:
    """One step of the windows that still run."""

    kernel: InterpretedKernel
    inputs: Inputs
    rows: Integers  # (w,): Row of this step in `inputs`, for each window
    start_s: Floats  # (w,): Time at the beginning of the step since the flight's first sample
    parameters: Floats  # (p,): All parameters of the model

    def evaluate(self, name: str, share: float, states: _States) -> _States:
        """Evaluate a function of the model within the step, and its sensitivities by the chain rule."""
        inputs, functions = self.inputs, self.kernel.functions
        # Each voltage is linear within a step.
        from_middle = share - 0.5
        volts_V = inputs.mean_V[self.rows] + from_middle * inputs.change_V[self.rows]
        t_s = self.start_s + share * inputs.step_s
        at = Trajectory(t_s, states.value, volts_V, 0.0, self.parameters)
        if states.sensitivity.shape[2] == 0:
            (result,) = self.kernel.program(name)(at)
            return _States(result[:, :, 0], np.zeros((*result.shape[:2], 0)))
        result, by_state, by_free, by_voltage = self.kernel.program(f"{name}_jacobian")(at)
        sensitivity: Floats = by_state @ states.sensitivity
        sensitivity[:, :, functions.state_count :] += by_free
        for derivative in inputs.voltage_derivatives:
            if derivative.parameter in functions.voltage_parameters:
                column = functions.state_count + functions.free.index(derivative.parameter)
                voltage_rate = derivative.of_mean[self.rows] + from_middle * derivative.of_change[self.rows]
                sensitivity[:, :, column] += np.einsum("wij,wj->wi", by_voltage, voltage_rate)
        return _States(result[:, :, 0], sensitivity)

    def advance(self, states: _States) -> _States:
        """Integrate the states to the end of the step, by Runge-Kutta steps of fourth order."""
        share = 1.0 / self.inputs.substeps
        substep_s = self.inputs.step_s * share
        for substep in range(self.inputs.substeps):
            start_share, middle_share, end_share = (
                substep * share,
                (substep + 0.5) * share,
                (substep + 1) * share,
            )
            k1 = self.evaluate("rates", start_share, states)
            k2 = self.evaluate("rates", middle_share, states.moved(k1, substep_s / 2))
            k3 = self.evaluate("rates", middle_share, states.moved(k2, substep_s / 2))
            k4 = self.evaluate("rates", end_share, states.moved(k3, substep_s))
            rate_sum = _States(
                k1.value + 2 * k2.value + 2 * k3.value + k4.value,
                k1.sensitivity + 2 * k2.sensitivity + 2 * k3.sensitivity + k4.sensitivity,
            )
            states = states.moved(rate_sum, substep_s / 6)
            if self.kernel.functions.has_reset:
                states = self.evaluate("reset_map", end_share, states)
        return states


def kernel(model: Model, free: tuple[str, ...], threads: int | None = None) -> Kernel:
    """Return the kernel of a model: compiled if there is a C compiler, otherwise interpreted."""
    functions, source = _functions_and_source(model, free)
    library = compile_source("identify", source)
    if library is None:
        return InterpretedKernel(functions)
    return CompiledKernel(functions, str(library), default_thread_count() if threads is None else threads)


@functools.lru_cache(maxsize=4)
def _functions_and_source(model: Model, free: tuple[str, ...]) -> tuple[Functions, str]:
    """Return the functions of a kernel, and its source in C."""
    # The results are kept, because flights are predicted one after the other with the same model, and
    # deriving its equations takes as long as predicting one flight.
    functions = Functions(model, free)
    return functions, kernel_source(functions)
