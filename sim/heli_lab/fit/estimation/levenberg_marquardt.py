"""The Levenberg-Marquardt method: control of the damping, and convergence (Nocedal and Wright, section 10.3).

A problem may have further unknowns next to its parameters, such as initial states. It eliminates them from
its normal equations, so that only steps of the parameters are seen here.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, Generic, Protocol, TypeVar

import numpy as np
from heli_host.data.arrays import Floats

SMALL_STEP: Final = 0.02
"""A step is small if no parameter changes by more than this share of its standard error: the remaining error
is then well inside the standard error. An undamped step ends the search if it is predicted to reduce the cost
by less than the square of this."""
_MAX_DAMPING: Final = 1e8
"""Damping beyond which the search ends: steps are then smaller than any printed digit."""
_MIN_DAMPING: Final = 0.05
"""Damping below which it is set to 0, and Gauss-Newton steps are whole."""
_IDLE_GAIN: Final = 1e-3
"""If the cost falls by less than this share in each of two steps, the search has converged, even if the steps
are not small. Set on flights with backlash and dry friction, whose kinks keep steps from becoming small. A
single step that is small and gains less than this ends the search too."""
_CONVERGED_GAIN: Final = 1e-6
"""A lightly damped step that reduces the cost by less than this share ends the search."""


class HasCost(Protocol):
    """Values of all unknowns."""

    @property
    def cost(self) -> float:
        """Weighted sum of squares, priors included: minus twice the log-posterior up to a constant."""


IterateT = TypeVar("IterateT", bound=HasCost)


@dataclass(frozen=True)
class DampedStep(Generic[IterateT]):
    """Levenberg-Marquardt step, and the evaluation of the model after it."""

    move: Floats  # (f,): Step of the free parameters
    std: Floats  # (f,): Standard errors of the free parameters
    promised: float  # Predicted reduction of the cost by the step, as if the cost were quadratic
    evaluate: Callable[[], IterateT]  # Evaluates the model after the step, and returns the iterate there


class LeastSquares(Protocol[IterateT]):
    """A nonlinear least-squares problem."""

    def step(self, iterate: IterateT, damping: float) -> DampedStep[IterateT]:
        """Linearise the problem at an `iterate`, and solve for a step with this `damping`."""

    def with_states_refined(self, iterate: IterateT) -> IterateT | None:
        """Optimise the eliminated unknowns of an `iterate` alone; None if that gains too little."""

    def is_out_of_budget(self) -> bool:
        """Whether the search has used up its limits of time or evaluations."""


@dataclass(frozen=True)
class Minimum(Generic[IterateT]):
    """Result of a search."""

    iterate: IterateT  # The iterate of the lowest cost
    converged: bool
    """Whether a further step would be small, or gain little. False if the steps or the budget ran out first,
    or if the model diverges after every step."""
    damping: float  # Damping that a further step would have


class _Damping:
    """Damping of the next step, in a unit in which 1 is strong damping."""

    def __init__(self, value: float) -> None:
        self.value = value
        self._growth = 2.0

    def increase(self) -> None:
        """Increase the damping after a rejected step, by a larger factor each time."""
        self.value = max(1.0, self._growth * self.value)
        self._growth *= 2.0

    def decrease(self) -> None:
        """Decrease the damping after an accepted step: slowly if the step before it was rejected, because
        otherwise every second step is rejected.
        """
        self.value *= 0.2 if self._growth == 2.0 else 0.5
        self.value = self.value if self.value > _MIN_DAMPING else 0.0
        self._growth = 2.0


def minimise(
    problem: LeastSquares[IterateT],
    start: IterateT,
    *,
    damping: float,
    max_steps: int,
    idle_share: float = 1.0,
    on_step: Callable[[int, float], None] = lambda number, cost: None,
) -> Minimum[IterateT]:
    """Minimise the cost by Levenberg-Marquardt steps, until the steps are small or gain little."""
    iterate, control = start, _Damping(damping)
    states_are_refined, idle_steps = False, 0
    for number in range(max_steps):
        on_step(number, iterate.cost)
        step = problem.step(iterate, control.value)
        if problem.is_out_of_budget():
            break
        if control.value == 0.0 and step.promised < SMALL_STEP**2:
            return Minimum(iterate, True, control.value)
        trial = step.evaluate()
        is_small = bool(np.all(np.abs(step.move) < SMALL_STEP * step.std))
        if trial.cost < iterate.cost * (1 + 1e-12):
            gain = (iterate.cost - trial.cost) / max(trial.cost, 1e-300)
            control.decrease()
            iterate, states_are_refined = trial, False
            idle_steps = idle_steps + 1 if gain < idle_share * _IDLE_GAIN else 0
            converged = gain < _CONVERGED_GAIN or (is_small and gain < _IDLE_GAIN)
            if idle_steps == 2 or (control.value < 1.0 and converged):
                return Minimum(iterate, True, control.value)
        elif not states_are_refined and (better := problem.with_states_refined(iterate)) is not None:
            iterate, states_are_refined = better, True
        elif control.value > _MAX_DAMPING or (is_small and len(step.move)):
            # The smallest steps gain nothing, unless the model diverges at each of them.
            return Minimum(iterate, bool(np.isfinite(trial.cost)), control.value)
        else:
            control.increase()
            # The iterate stays the same, so that refining its states again would gain nothing.
            states_are_refined = True
    return Minimum(iterate, False, control.value)
