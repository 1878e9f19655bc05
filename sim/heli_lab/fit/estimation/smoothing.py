"""Estimate the disturbances of a flight from all its measurements, and follow its states again.

The smoother is that of Harvey, section 3.6.
"""

from __future__ import annotations

import numpy as np
from heli_host.data.arrays import Floats

from heli_lab.fit.estimation import _kalman
from heli_lab.fit.estimation.disturbances import DisturbanceModel
from heli_lab.fit.estimation.innovations_model import InnovationsModel
from heli_lab.fit.estimation.reference_trajectory import ReferenceTrajectory


def smoothed_disturbances(
    filtered: InnovationsModel, disturbances: DisturbanceModel
) -> list[tuple[Floats, Floats, Floats]]:
    """Estimate the disturbances given each whole flight, by the fixed-interval smoother.

    Parameters
    ----------
    filtered : InnovationsModel
        The model along the flights.
    disturbances : DisturbanceModel
        Disturbances and quantisation.

    Returns
    -------
    list of (ndarray (k,), ndarray (k, m), ndarray (k, m))
        For each flight: times since its first sample [s], the sum of the fast and the slow disturbance of
        each output in the unit of the disturbed parameter, and the standard error of this sum.
    """
    result = []
    outputs = len(filtered.model.outputs)
    for linearised, signals in zip(filtered.linearised_flights, filtered.perturbed_residual(), strict=True):
        times, values, errors = [], [], []
        for blocks, (drive, measured) in zip(linearised.blocks, signals, strict=True):
            system = filtered.system(linearised, blocks, disturbances)
            # Columns: states of the model, then the fast disturbances, then the slow ones.
            mean, variance = _kalman.smooth(*system, drive, measured)
            first_fast = blocks.transition.shape[1]
            first_slow = first_fast + blocks.part_input.shape[3]
            fast, slow = (slice(first, first + outputs) for first in (first_fast, first_slow))
            times.append(linearised.nodes.t_s[blocks.rows])
            values.append(mean[:, fast] + mean[:, slow])
            errors.append(np.sqrt(variance[:, fast] + variance[:, slow]))
        result.append((np.concatenate(times), np.concatenate(values), np.concatenate(errors)))
    return result


def refiltered(filtered: InnovationsModel, disturbances: DisturbanceModel) -> list[ReferenceTrajectory]:
    """Estimate the reference trajectories again, now with the model's equations and its disturbances.

    Unlike the filter of the likelihood, this filter takes a measurement in every step.

    Parameters
    ----------
    filtered : InnovationsModel
        The model along the present references.
    disturbances : DisturbanceModel
        Disturbances and quantisation.

    Returns
    -------
    list of ReferenceTrajectory
        New reference of each flight.
    """
    references = []
    for linearised in filtered.linearised_flights:
        reference = linearised.reference
        predicted, corrected = reference.predicted.copy(), reference.filtered.copy()
        steps, followed = linearised.steps, filtered.model.followed
        disturbance_input = steps.Gamma @ steps.by_disturbance
        for window, rows in zip(linearised.windows, reference.windows, strict=True):
            before, after = _kalman.track(
                steps.Phi[window],
                np.ascontiguousarray(disturbance_input[window])[None],
                steps.C[window],
                np.ascontiguousarray(linearised.variance[window] * disturbances.quantisation),
                disturbances.autocorrelation(reference.step_s),
                disturbances.variance,
                filtered.model.initial_std**2,
                steps.drive[window],
                steps.output_error[window],
            )
            predicted[rows] = reference.predicted[rows] + before[:, :followed]
            corrected[rows] = reference.predicted[rows] + after[:, :followed]
        references.append(reference.refiltered(predicted, corrected))
    return references
