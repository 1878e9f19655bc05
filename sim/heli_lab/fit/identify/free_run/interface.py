"""The interface of all kernels, which simulate a model over many windows with exact derivatives."""

from __future__ import annotations

from abc import ABC, abstractmethod

from heli_host.arrays import Floats

from heli_lab.fit.identify.free_run.functions import Inputs


class Kernel(ABC):
    """Simulates w windows, which have n steps in total. Compiled and interpreted kernels agree to the
    rounding of doubles.
    """

    @abstractmethod
    def predict(self, inputs: Inputs, start: Floats, parameters: Floats) -> tuple[Floats, Floats]:
        """Simulate every window from its initial state.

        Parameters
        ----------
        start : ndarray (w, states)
            Initial states.
        parameters : ndarray (p,)
            All parameters of the model.

        Returns
        -------
        angles_rad : ndarray (n, 3)
            Measured angles at the beginning of each step.
        end : ndarray (w, states)
            States at the end of each window.
        """

    @abstractmethod
    def jacobian(self, inputs: Inputs, start: Floats, parameters: Floats) -> tuple[Floats, Floats]:
        """Simulate as `predict` does, with derivatives.

        Parameters
        ----------
        start, parameters
            As in `predict`.

        Returns
        -------
        angles_rad : ndarray (n, 3)
            Measured angles at the beginning of each step.
        jacobian : ndarray (n, 3, states + free)
            Their derivatives to the window's initial state and to the free parameters.
        """

    @abstractmethod
    def products(
        self, inputs: Inputs, start: Floats, parameters: Floats, measured_rad: Floats, sigma_rad: Floats
    ) -> tuple[Floats, Floats]:
        """Simulate as `predict` does, and sum the products that the normal equations need.

        Parameters
        ----------
        start, parameters
            As in `predict`.
        measured_rad : ndarray (n, 3)
            Angles to compare with.
        sigma_rad : ndarray (3,)
            Unit of the residuals.

        Returns
        -------
        angles_rad : ndarray (n, 3)
            Measured angles at the beginning of each step.
        normal_matrix : ndarray (w, 3, states + free + 1, states + free + 1)
            For each window and axis, products of the columns of [Jacobian | residual], both divided by sigma.
        """
