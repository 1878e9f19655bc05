"""The interface of the kernels: free runs over many windows, with exact derivatives."""

from __future__ import annotations

from abc import ABC, abstractmethod

from heli_host.arrays import Floats

from heli_lab.identify.free_run.functions import Inputs


class Kernel(ABC):
    """Runs windows; compiled and interpreted kernels agree to the rounding of doubles."""

    @abstractmethod
    def run(
        self, inputs: Inputs, start: Floats, parameters: Floats, derivatives: bool = True
    ) -> tuple[Floats, Floats | None]:
        """Run every window from its initial state.

        Parameters
        ----------
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

    @abstractmethod
    def products(
        self, inputs: Inputs, start: Floats, parameters: Floats, measured_rad: Floats, sigma_rad: Floats
    ) -> tuple[Floats, Floats]:
        """Run every window and sum the products that the normal equations need.

        Parameters
        ----------
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
        normal_matrix : ndarray (w, 3, states + free + 1, states + free + 1)
            For each window and axis, products of the columns of [Jacobian | residual], both over sigma.
        """

    @abstractmethod
    def end(self, inputs: Inputs, start: Floats, parameters: Floats) -> Floats:
        """Run every window from its initial state in `start`, shape (w, states), with all `parameters` of the
        model, shape (p,), and return the states at their ends, shape (w, states).
        """
