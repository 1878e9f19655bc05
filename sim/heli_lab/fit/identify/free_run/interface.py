"""The interface of all kernels, which simulate a model over many windows with exact derivatives."""

from __future__ import annotations

from abc import ABC, abstractmethod

from heli_host.data.arrays import Floats

from heli_lab.fit.identify.free_run.functions import Inputs


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
        `measured_rad` (n, 3), `sigma_rad` (3,); returns `angles_rad` (n, 3), `normal_matrix` (w, 3,
        states + free + 1, states + free + 1).
        """
