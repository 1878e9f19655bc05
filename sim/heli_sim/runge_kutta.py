"""One Runge-Kutta step of fourth order, for numbers and for symbols."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any


def runge_kutta_step(derivative: Callable[[Any, float], Any], state: Any, step: float) -> Any:
    """Integrate over one step with the classical Runge-Kutta method of fourth order.

    Examples
    --------
    >>> from heli_sim.runge_kutta import runge_kutta_step
    >>> round(runge_kutta_step(lambda x, _: -x, 1.0, 0.1), 6)
    0.904837
    """
    k1 = derivative(state, 0.0)
    k2 = derivative(state + step / 2 * k1, step / 2)
    k3 = derivative(state + step / 2 * k2, step / 2)
    k4 = derivative(state + step * k3, step)
    return state + step / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
