"""Free runs of a model over many windows, with exact derivatives: the inner loop of every fit.

CasADi writes the rates of the state and their Jacobians as C; around them stands a short loop, also C, that
carries the state and its sensitivities to the window's initial state and to the free parameters through
Runge-Kutta steps of fourth order. Both are compiled together and kept in the user's cache. Without a compiler
the same loop runs in NumPy on CasADi's virtual machine.
"""

from __future__ import annotations

from typing import Protocol

from heli_sim.compiled import compile_source
from heli_sim.identify.compiled_kernel import CompiledKernel, driver
from heli_sim.identify.functions import Floats, Functions, Inputs
from heli_sim.identify.interpreted_kernel import InterpretedKernel
from heli_sim.model.base import Model


class Kernel(Protocol):
    """Runs windows; compiled and interpreted kernels agree to rounding."""

    def run(
        self, inputs: Inputs, start: Floats, parameters: Floats, derivatives: bool = True
    ) -> tuple[Floats, Floats | None]:
        """Run every window from its initial state.

        Parameters
        ----------
        inputs : Inputs
            What drives the windows.
        start : ndarray (w, states)
            Initial states.
        parameters : ndarray (p,)
            All parameters of the model.
        derivatives : bool
            Whether to compute the Jacobian.

        Returns
        -------
        angles_rad : ndarray (n, 3)
            Measured angles at the beginning of each step.
        jacobian : ndarray (n, 3, states + free) or None
            Their derivatives to the window's initial state and to the free parameters.
        """
        ...

    def products(
        self, inputs: Inputs, start: Floats, parameters: Floats, measured_rad: Floats, sigma_rad: Floats
    ) -> tuple[Floats, Floats]:
        """Run every window and multiply up what the normal equations need.

        Parameters
        ----------
        inputs : Inputs
            What drives the windows.
        start : ndarray (w, states)
            Initial states.
        parameters : ndarray (p,)
            All parameters of the model.
        measured_rad : ndarray (n, 3)
            Angles to compare with.
        sigma_rad : ndarray (3,)
            Unit of the residuals.

        Returns
        -------
        angles_rad : ndarray (n, 3)
            Measured angles at the beginning of each step.
        gram : ndarray (w, 3, states + free + 1, states + free + 1)
            For each window and axis, products of the columns of [Jacobian | residual], both over sigma.
        """
        ...

    def end(self, inputs: Inputs, start: Floats, parameters: Floats) -> Floats:
        """Run every window and return the states at their ends.

        Parameters
        ----------
        inputs : Inputs
            What drives the windows.
        start : ndarray (w, states)
            Initial states.
        parameters : ndarray (p,)
            All parameters of the model.

        Returns
        -------
        ndarray (w, states)
            State after each window's last step.
        """
        ...


def kernel(model: Model, free: tuple[str, ...]) -> Kernel:
    """Build or find the kernel of a model.

    Parameters
    ----------
    model : Model
        The model.
    free : tuple of str
        Names of the parameters to differentiate to, in this order.

    Returns
    -------
    Kernel
        Compiled, or interpreted where there is no C compiler.

    Raises
    ------
    PlantError
        When the compiler fails.
    """
    functions = Functions(model, free)
    library = compile_source("identify", driver(functions))
    return InterpretedKernel(functions) if library is None else CompiledKernel(functions, str(library))
