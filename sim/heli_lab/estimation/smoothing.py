"""Disturbances and states given all measurements of a flight (Harvey, section 3.6)."""

from __future__ import annotations

import numpy as np
from heli_host.arrays import Floats

from heli_lab.estimation import _kalman
from heli_lab.estimation.disturbances import DisturbanceModel
from heli_lab.estimation.innovations_model import InnovationsModel
from heli_lab.estimation.reference_trajectory import ReferenceTrajectory


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
        For each flight times since its first sample (s), the sum of the fast and the slow disturbance of
        each output in the unit of the disturbed parameter, and its standard error.
    """
    result = []
    m = len(filtered.model.outputs)
    for linearised, signals in zip(filtered.linearised_flights, filtered.perturbed_residual(), strict=True):
        times, values, errors = [], [], []
        for blocks, (drive, measured) in zip(linearised.blocks, signals, strict=True):
            nx = blocks.transition.shape[1]
            system = filtered.system(linearised, blocks, disturbances)
            mean, variance = _kalman.smooth(*system, drive, measured)
            times.append(linearised.nodes.t_s[blocks.rows])
            slow = nx + blocks.part_input.shape[3]
            values.append(mean[:, nx : nx + m] + mean[:, slow : slow + m])
            errors.append(np.sqrt(variance[:, nx : nx + m] + variance[:, slow : slow + m]))
        result.append((np.concatenate(times), np.concatenate(values), np.concatenate(errors)))
    return result


def refiltered(filtered: InnovationsModel, disturbances: DisturbanceModel) -> list[ReferenceTrajectory]:
    """Follow the flights again with the filter of an innovations model, with a measurement in every step.

    Parameters
    ----------
    filtered : InnovationsModel
        The model along the present references.
    disturbances : DisturbanceModel
        Disturbances and quantisation.

    Returns
    -------
    list of ReferenceTrajectory
        One per flight.
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
