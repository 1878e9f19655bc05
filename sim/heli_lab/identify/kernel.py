"""Free runs of a model over many windows, with exact derivatives: the inner loop of every fit.

CasADi writes the rates of the state and their Jacobians as C; around them stands a short loop, also C, that
carries the state and its sensitivities to the window's initial state and to the free parameters through
Runge-Kutta steps of fourth order. Both are compiled together and kept in the user's cache. Without a compiler
the same loop runs in NumPy on CasADi's virtual machine.
"""

from __future__ import annotations

import os

from heli_sim.compiled import compile_source
from heli_sim.model.base import Model

from heli_lab.identify.compiled_kernel import CompiledKernel, driver
from heli_lab.identify.functions import Functions
from heli_lab.identify.interpreted_kernel import InterpretedKernel
from heli_lab.identify.windows import Kernel

__all__ = ["Kernel", "kernel"]


def kernel(model: Model, free: tuple[str, ...], threads: int | None = None) -> Kernel:
    """Build or find the kernel of a model, with derivatives to the parameters `free`, in this order:
    compiled, its windows shared out to `threads` (`usual_threads` where None), or interpreted where there is
    no C compiler. A PlantError when the compiler fails.
    """
    functions = Functions(model, free)
    library = compile_source("identify", driver(functions))
    if library is None:
        return InterpretedKernel(functions)
    return CompiledKernel(functions, str(library), usual_threads() if threads is None else threads)


def usual_threads() -> int:
    """Threads of a process that was not told how many: two, or one where ``OMP_NUM_THREADS`` is 1, which is
    how one says that other processes have the other cores.
    """
    return 1 if os.environ.get("OMP_NUM_THREADS") == "1" else 2
