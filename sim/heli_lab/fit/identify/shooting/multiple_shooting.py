"""Steps of multiple shooting, which fit parameters and the initial states of all windows together (Bock,
1987).

The normal equations have a block for the initial state of each window, which is coupled to the free
parameters only. Eliminating these blocks (Schur complement) leaves a system of the free parameters alone.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Final

import numpy as np

from heli_lab.fit.estimation.levenberg_marquardt import DampedStep, minimise
from heli_lab.fit.estimation.posterior_step import posterior_step
from heli_lab.fit.identify import thresholds
from heli_lab.fit.identify.estimation_problem import Budget, FitProgress
from heli_lab.fit.identify.shooting.schur import eliminate_states
from heli_lab.fit.identify.shooting.shooting_cost import Iterate, ShootingCost
from heli_lab.fit.identify.shooting.window_recovery import recover_windows, reoptimise_states

_FINE_IDLE_SHARE: Final = 0.2
"""Factor on the smallest gain of a step that counts, when every sample is compared. Two steps below it
end the search. It is less than 1 because the fit on the coarse grid is already near the minimum."""


class MultipleShooting:
    """Gauss-Newton steps of a multiple-shooting fit, for the Levenberg-Marquardt search in `minimise`.
    `is_fixed` has shape (f,).
    """

    def __init__(
        self, cost: ShootingCost, budget: Budget, on_progress: Callable[[FitProgress], None] | None
    ) -> None:
        self.cost = cost
        self.damping = 0.0
        self.is_fixed = np.zeros(len(cost.problem.free), bool)
        self.started_s = time.perf_counter()
        self._budget = budget
        self._on_progress = on_progress or (lambda progress: None)

    def is_out_of_budget(self) -> bool:
        """Whether the fit has used all its evaluations or all its time."""
        elapsed_s = time.perf_counter() - self.started_s
        budget = self._budget
        return self.cost.evaluations >= budget.max_evaluations or elapsed_s >= budget.max_time_s

    def step(self, iterate: Iterate, damping: float) -> DampedStep[Iterate]:
        """Linearise the model at an `iterate`, and solve for a Levenberg-Marquardt step with this
        `damping`.
        """
        cost, problem = self.cost, self.cost.problem
        reduced = eliminate_states(cost, iterate, thresholds.STATE_DAMPING * damping)
        step = posterior_step(
            problem.parameter_vector,
            iterate.theta,
            reduced.information,
            reduced.gradient,
            damping=damping,
            is_fixed=self.is_fixed,
        )

        def iterate_after_step() -> Iterate:
            """Evaluate the model after the step, and recover the windows that diverge there."""
            states = []
            for index, columns in enumerate(problem.columns):
                # Shape (w, states): change of the initial states because the parameters change.
                response = np.einsum("wsf,f->ws", reduced.state_responses[index], step.move[columns])
                states.append(iterate.states[index] + reduced.state_steps[index] - response)
            after = cost.evaluate(iterate.theta + step.move, states)
            recover_windows(cost, after, iterate)
            return after

        # The cost is twice the negative log-posterior.
        predicted_reduction = reduced.predicted_reduction + 2.0 * step.promised_nats
        return DampedStep(step.move, step.std, predicted_reduction, iterate_after_step)

    def with_states_refined(self, iterate: Iterate) -> Iterate | None:
        """Optimise the initial states of an `iterate` alone; None if they have converged."""
        return reoptimise_states(self.cost, iterate)

    def descend(
        self, iterate: Iterate, stage: str, work_done: tuple[float, float], max_steps: int
    ) -> tuple[Iterate, bool]:
        """Reduce the cost by Levenberg-Marquardt steps until the steps are small. Shapes: `work_done`
        (float, float). Returns `iterate`, `converged`.
        """

        def report(number: int, cost: float) -> None:
            """Report the progress after step `number`."""
            before, after = work_done
            # The number of steps is not known: each one counts for half of the work that remains.
            done = before + (after - before) * (1 - 0.5**number)
            self._on_progress(FitProgress(stage, done, cost))

        minimum = minimise(
            self,
            iterate,
            damping=self.damping,
            max_steps=max_steps,
            idle_share=_FINE_IDLE_SHARE if self.cost.fine else 1.0,
            on_step=report,
        )
        self.damping = minimum.damping
        return minimum.iterate, minimum.converged
