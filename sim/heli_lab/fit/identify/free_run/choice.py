"""Free runs of a model over many windows, with exact derivatives: the inner loop of every fit.

A kernel simulates all windows, and propagates the state with its sensitivities to the window's initial state
and to the free parameters. There are two. The compiled kernel (`compiled.py`) has the rates of the state and
their Jacobians as C, and a loop of fourth-order Runge-Kutta steps around them; its library is kept in the
user's cache. Without a C compiler, the interpreted kernel (`interpreted.py`) runs the same loop in NumPy. The
compiled one takes 11 ms for 20 windows of 2 s with 21 free parameters (2026-11). The interpreted one takes
longer even without sensitivities: 13 to 31 ms.
"""

from __future__ import annotations

import functools
from pathlib import Path

from heli_sim.compiled import compile_source
from heli_sim.model.base import Model

from heli_lab.fit.identify.free_run.compiled import CompiledKernel, kernel_source
from heli_lab.fit.identify.free_run.functions import Functions
from heli_lab.fit.identify.free_run.interface import Kernel
from heli_lab.fit.identify.free_run.interpreted import InterpretedKernel
from heli_lab.threads import default_thread_count


def kernel(model: Model, free: tuple[str, ...], threads: int | None = None) -> Kernel:
    """Return the kernel of a model: compiled if there is a C compiler, otherwise interpreted."""
    functions, library = _functions_and_library(model, free)
    if library is None:
        return InterpretedKernel(functions)
    return CompiledKernel(functions, str(library), default_thread_count() if threads is None else threads)


@functools.lru_cache(maxsize=4)
def _functions_and_library(model: Model, free: tuple[str, ...]) -> tuple[Functions, Path | None]:
    """Return the functions of a kernel, and its compiled library if there is a C compiler.

    The results are kept, because flights are predicted one after the other with the same model, and deriving
    its equations takes as long as predicting one flight.
    """
    functions = Functions(model, free)
    return functions, compile_source("identify", kernel_source(functions))
