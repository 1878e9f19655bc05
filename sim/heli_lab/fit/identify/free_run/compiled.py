"""The kernel in C: a model's rates and Jacobians are written as C, and compiled with the loop `windows.c`."""

from __future__ import annotations

import ctypes
import itertools
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import casadi as ca
import numpy as np
from heli_host.data.arrays import Floats, Integers
from heli_sim.errors import PlantError
from typing_extensions import override

from heli_lab.fit.identify.free_run.functions import Functions, Inputs
from heli_lab.fit.identify.free_run.interface import Kernel
from heli_lab.fit.identify.free_run.lanes import c_function
from heli_lab.threads import parallel_map

_WORTH_THREADS_ROWS: Final = 500
"""Steps from which on a second thread saves more than it costs to start."""

LOOP: Final = Path(__file__).with_name("windows.c")
"""The loop around these functions; its head describes the macros that it needs."""
_FUNCTIONS: Final = "/* The functions of the model end here. */"
"""Line of the loop before which these functions are inserted."""


def _chain_rule_macro(functions: Functions, function: ca.Function) -> str:
    """Write the chain rule for the sensitivities of a function in C, as the body of a macro.

    The sensitivities are out = fx s + fp + fu du: the Jacobians fx, fp and fu to state, free parameters and
    voltages, the sensitivities s of the state, and the derivatives du of the voltages. Elements that are
    always zero are left out.
    """
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
        windows = len(inputs.steps)
        angles = np.empty((inputs.rows, 3))
        end = np.empty((windows, self._state_count))
        arrays = (inputs.mean_V, inputs.change_V, inputs.start_s, start, parameters)
        mean, change, start_s, x0, p = (np.ascontiguousarray(array, float) for array in arrays)
        # These dictionaries also keep the arrays alive while C has their addresses.
        of_mean = {by.parameter: np.ascontiguousarray(by.of_mean) for by in inputs.voltage_derivatives}
        of_change = {by.parameter: np.ascontiguousarray(by.of_change) for by in inputs.voltage_derivatives}
        mean_pointers, change_pointers = self._pointers(of_mean), self._pointers(of_change)
        first, steps = inputs.first, np.ascontiguousarray(inputs.steps, np.int64)

        def run_windows(low: int, high: int) -> None:
            """Run the windows `low` to `high` - 1 in C; the arguments are those of heli_windows."""
            self._windows(
                ctypes.c_longlong(high - low),
                *(_row_address(array, low) for array in (first, steps, start_s)),
                ctypes.c_double(inputs.step_s),
                ctypes.c_longlong(inputs.substeps),
                *(_row_address(mean), _row_address(change), mean_pointers, change_pointers),
                *(
                    _row_address(x0, low),
                    _row_address(p),
                    _row_address(angles),
                    _row_address(jacobian),
                    _row_address(end, low),
                ),
                _row_address(products.measured_rad if products else None),
                _row_address(products.sigma_rad if products else None),
                _row_address(products.result if products else None, low),
            )

        # Python threads run in parallel here, because the call of C releases Python's global lock.
        if self._threads == 1 or windows < 2 or inputs.rows < _WORTH_THREADS_ROWS:
            run_windows(0, windows)
            return angles, end
        # Each thread gets consecutive windows with about the same number of steps.
        steps_before = inputs.rows * np.arange(1, self._threads) / self._threads
        inner = np.minimum(np.searchsorted(np.cumsum(steps), steps_before) + 1, windows)
        edges = [0, *(int(edge) for edge in np.unique(inner) if edge < windows), windows]
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
