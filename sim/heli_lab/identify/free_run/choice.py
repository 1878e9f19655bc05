"""Free runs of a model over many windows, with exact derivatives: the inner loop of every fit.

The rates of the state and their Jacobians, which CasADi derives, are written as C (`lanes.py`). A short loop
around them, also in C, takes Runge-Kutta steps of fourth order in four windows together. It propagates the
state and its sensitivities to the window's initial state and to the free parameters. Both are compiled
together and kept in the user's cache. Without a compiler the same loop runs in NumPy around the expression
programs of `heli_lab.estimation`. These alone, without any sensitivities, take longer than the compiled
kernel takes for everything: 13 to 31 ms against 11 ms for 20 windows of 2 s, 21 free parameters (2026-11).
"""

from __future__ import annotations

import functools
from pathlib import Path

from heli_sim.compiled import compile_source
from heli_sim.model.base import Model

from heli_lab.identify.free_run.compiled import CompiledKernel, kernel_source
from heli_lab.identify.free_run.functions import Functions
from heli_lab.identify.free_run.interface import Kernel
from heli_lab.identify.free_run.interpreted import InterpretedKernel
from heli_lab.threads import default_thread_count


def kernel(model: Model, free: tuple[str, ...], threads: int | None = None) -> Kernel:
    """Build or find the kernel of a model, with derivatives to the parameters `free`, in this order:
    compiled, its windows on `threads` (`default_thread_count` where None), or interpreted where there is
    no C compiler. A PlantError when the compiler fails.
    """
    functions, library = _built(model, free)
    if library is None:
        return InterpretedKernel(functions)
    return CompiledKernel(functions, str(library), default_thread_count() if threads is None else threads)


@functools.lru_cache(maxsize=4)
def _built(model: Model, free: tuple[str, ...]) -> tuple[Functions, Path | None]:
    """Functions of a kernel, and its library if there is a C compiler. Flights are predicted one after the
    other with the same model; to derive and to write its equations takes as long as to predict one of them.
    """
    functions = Functions(model, free)
    return functions, compile_source("identify", kernel_source(functions))
