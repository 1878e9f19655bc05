"""Auxiliary residuals: score tests of a shock at every instant, by one backward pass of the smoother.

For each output, two shocks of its disturbance are tested in every measurement interval: a level shift, which
begins there and stays, and an impulse of one step (Harvey and Koopman, J. Bus. Econ. Stat. 10 (1992) 377; de
Jong and Penzer, J. Am. Stat. Assoc. 93 (1998) 796). Each shock is an additional state of the model without
variance. The smoother's adjoint of that state is the score of a shock at every instant, and the diagonal of
the adjoint's matrix is its information.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from heli_host.data.arrays import Floats

from heli_lab.fit.estimation import _kalman
from heli_lab.fit.estimation.disturbances import DisturbanceModel
from heli_lab.fit.estimation.innovations_model import FilterSystem, FlightErrors, InnovationsModel

_LEVEL, _IMPULSE = 1.0, 0.0
"""Autocorrelation of the two shocks over a step: a level stays, an impulse vanishes."""


@dataclass(frozen=True)
class ShockScores:
    """Score tests of one kind of shock in one flight, with all parameters and disturbances fixed.

    Parameters
    ----------
    score : ndarray (k, m)
        Derivative of the log-likelihood to a shock of each output's disturbance at each instant.
    information : ndarray (k, m)
        Fisher information of that shock; 0 if nothing is measured afterwards.
    """

    score: Floats
    information: Floats

    @property
    def t_statistic(self) -> Floats:
        """Statistic of a t test of the shock, shape (k, m): standard normal if there is none."""
        return self._score_over(np.sqrt(np.maximum(self.information, 0.0)))

    @property
    def size(self) -> Floats:
        """Most likely size of the shock, in the unit of the disturbed parameter, shape (k, m)."""
        return self._score_over(self.information)

    def _score_over(self, divisor: Floats) -> Floats:
        """Divide the score by a `divisor`, shape (k, m); the result is 0 if the divisor is 0."""
        return np.divide(self.score, divisor, out=np.zeros_like(self.score), where=divisor > 0.0)


@dataclass(frozen=True)
class AuxiliaryResiduals:
    """Score tests of shocks at every instant of one flight.

    Parameters
    ----------
    t_s : ndarray (k,)
        Instants since the flight's first sample: the beginnings of the measurement intervals.
    level, impulse : ShockScores
        A torque that begins at an instant and stays, and one during the step that begins there.
    """

    t_s: Floats
    level: ShockScores
    impulse: ShockScores

    def largest_level(self) -> tuple[float, float]:
        """Find the most significant level shift of any output.

        Returns
        -------
        t_s : float
            Instant of the shift [s].
        t_statistic : float
            Absolute t statistic of the shift.
        """
        statistic = np.abs(self.level.t_statistic).max(axis=1)
        largest = int(statistic.argmax())
        return float(self.t_s[largest]), float(statistic[largest])


def auxiliary_residuals(
    filtered: InnovationsModel,
    disturbances: DisturbanceModel,
    errors: FlightErrors | None = None,
) -> list[AuxiliaryResiduals]:
    """Test a shock of each output's disturbance at every instant of each flight.

    Parameters
    ----------
    filtered : InnovationsModel
        The model along the flights.
    disturbances : DisturbanceModel
        Disturbances and quantisation.
    errors : sequence of sequence of ModelErrors, optional
        Errors of the model from `InnovationsModel.perturbed_residual`; by default those at its parameters.

    Returns
    -------
    list of AuxiliaryResiduals
        One per flight.
    """
    if errors is None:
        errors = filtered.perturbed_residual()
    outputs, inputs = len(filtered.model.outputs), len(filtered.model.disturbed)
    # Columns of the shock states: a level of each input, then an impulse of each. The outputs' disturbances
    # are the first inputs; gains follow.
    level, impulse = slice(0, outputs), slice(inputs, inputs + outputs)
    results = []
    for linearised, windows in zip(filtered.linearised_flights, errors, strict=True):
        times, scores, information = [], [], []
        for blocks, (drive, measured) in zip(linearised.blocks, windows, strict=True):
            system = _with_shock_states(filtered.system(linearised, blocks, disturbances), inputs)
            state_scores, state_information = _kalman.shock_scores(*system, drive, measured)
            times.append(linearised.nodes.t_s[blocks.rows])
            # The shock states are the last ones.
            scores.append(state_scores[:, -2 * inputs :])
            information.append(state_information[:, -2 * inputs :])
        all_scores, all_information = np.concatenate(scores), np.concatenate(information)
        results.append(
            AuxiliaryResiduals(
                t_s=np.concatenate(times),
                level=ShockScores(all_scores[:, level], all_information[:, level]),
                impulse=ShockScores(all_scores[:, impulse], all_information[:, impulse]),
            )
        )
    return results


def _with_shock_states(system: FilterSystem, inputs: int) -> FilterSystem:
    """Append a level and an impulse of each input to a filter's states, both without variance."""
    return system._replace(
        autocorrelation=np.append(system.autocorrelation, np.repeat((_LEVEL, _IMPULSE), inputs)),
        disturbance_variance=np.append(system.disturbance_variance, np.zeros(2 * inputs)),
    )
