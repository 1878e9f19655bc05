"""The torque that a model lacks without a cause, estimated as a disturbance by a fixed-interval smoother."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from heli_host.data.arrays import Floats
from heli_sim.model.parts import AXES

from heli_lab.explain.discover.curve_quantities import (
    best_quantity,
    over_all_flights,
    quantities_and_thrust_changes,
    quantity_unit,
)
from heli_lab.explain.discover.missing import TIME, MissingTerm
from heli_lab.explain.search.candidate import Candidate
from heli_lab.explain.wording import display_unit, quantity_in_words
from heli_lab.fit.estimator import Estimate
from heli_lab.fit.flight_model import model_along
from heli_lab.fit.grey_box import DisturbanceModel
from heli_lab.fit.innovations import InnovationsModel, smoothed_disturbances
from heli_lab.fit.linearised_flight import LinearisedFlight


class _SmoothedTorque(NamedTuple):
    """Smoothed disturbances of all flights: times (k,), torques and standard errors (k, 3) [N m]."""

    t_s: Floats
    torque_Nm: Floats
    std_Nm: Floats


class _DrawnQuantity(NamedTuple):
    """Quantity over which a torque is drawn, in words: values (k,) in its display unit."""

    name: str
    unit: str
    values: Floats


class _MeasurementBlocks:
    """Steps of a flight, grouped by measurements of the filter; a measurement covers several steps."""

    def __init__(self, linear: LinearisedFlight) -> None:
        first_steps = np.concatenate([block.rows for block in linear.blocks])
        self._steps = first_steps[:, None] + np.arange(linear.block)  # (measurements, steps of each)

    def mean(self, values: Floats) -> Floats:
        """Return the means, shape (measurements, ...), of values of the steps, shape (n, ...)."""
        means: Floats = values[self._steps].mean(axis=1)
        return means


def contributed_torques_Nm(estimate: Estimate, reduced: Estimate) -> list[Floats]:
    """Compute the torque that is equivalent to an effect along each flight. Returns shape (n, 3).

    The torque causes the difference between the accelerations with and without the effect.
    """
    return [
        flight_without.disturbance_for(_accelerations_rad_s2(flight) - _accelerations_rad_s2(flight_without))
        for flight, flight_without in zip(
            estimate.filtered().linearised_flights, reduced.filtered().linearised_flights, strict=True
        )
    ]


def missing_torque(
    estimate: Estimate, reduced: Estimate, cause: Candidate, torques_Nm: Sequence[Floats]
) -> MissingTerm:
    """Estimate the torque that a model lacks without a cause. Shapes: `torques_Nm` (n, 3)."""
    filtered, reduced_filtered = estimate.filtered(), reduced.filtered()
    blocks_by_flight = [_MeasurementBlocks(linear) for linear in reduced_filtered.linearised_flights]
    contribution_Nm = np.concatenate(
        [blocks.mean(torque_Nm) for blocks, torque_Nm in zip(blocks_by_flight, torques_Nm, strict=True)]
    )
    missing = _smoothed_torque(reduced_filtered, reduced.disturbances)
    remaining = _smoothed_torque(filtered, estimate.disturbances)
    axis = _most_explained_axis(np.concatenate(torques_Nm), missing.torque_Nm, contribution_Nm)
    quantity = _drawn_quantity(filtered.linearised_flights, blocks_by_flight, contribution_Nm[:, axis], cause)
    if quantity is None:
        quantity = _DrawnQuantity(TIME, "s", missing.t_s)
    factor, unit = display_unit("N m")
    return MissingTerm(
        id=cause.id,
        what="torque",
        unit=unit,
        axis=AXES[axis],
        on=quantity.name,
        on_unit=quantity.unit,
        quantity=quantity.values,
        missing=factor * _without_mean(missing.torque_Nm[:, axis]),
        std=factor * missing.std_Nm[:, axis],
        remaining=factor * _without_mean(remaining.torque_Nm[:, axis]),
        contribution=factor * _without_mean(contribution_Nm[:, axis]),
    )


def _smoothed_torque(filtered: InnovationsModel, disturbances: DisturbanceModel) -> _SmoothedTorque:
    """Estimate the disturbance torques about the three axes by a fixed-interval smoother."""
    by_flight = smoothed_disturbances(filtered, disturbances)
    t_s, torque_Nm, std_Nm = (np.concatenate(values) for values in zip(*by_flight, strict=True))
    return _SmoothedTorque(t_s, torque_Nm, std_Nm)


def _accelerations_rad_s2(linear: LinearisedFlight) -> Floats:
    """Return the angular accelerations of the model along its trajectory, shape (n, 3) [rad/s2]."""
    model = linear.model.source
    (rates,) = model_along(model, lambda x, u, p, t: [model.dynamics(x, u, p, t)[3:6]])(linear.trajectory)
    return np.ascontiguousarray(rates[:, :, 0])


def _most_explained_axis(torque_Nm: Floats, missing_Nm: Floats, contribution_Nm: Floats) -> int:
    """Return the index of the axis on which a cause explains the missing torque best.

    This is the axis with the largest ratio of the torque of the cause, `torque_Nm` (n, 3), to the torque that
    it leaves unexplained; `missing_Nm` and `contribution_Nm` have the shape (measurements, 3).
    """
    # Standard deviations leave out the means: the mean elevation torque of a thrust curve would hide the
    # pitch torque of its lag.
    unexplained_std_Nm = (missing_Nm - contribution_Nm).std(axis=0)
    return int(np.argmax(torque_Nm.std(axis=0) / (unexplained_std_Nm + 1e-9)))


def _drawn_quantity(
    flights: Sequence[LinearisedFlight],
    blocks_by_flight: Sequence[_MeasurementBlocks],
    contribution_Nm: Floats,
    cause: Candidate,
) -> _DrawnQuantity | None:
    """Return the quantity of which a contribution (measurements,) is nearly a function; None without one."""
    quantities_by_flight = [
        {name: blocks.mean(values) for name, values in quantities_and_thrust_changes(linear).items()}
        for blocks, linear in zip(blocks_by_flight, flights, strict=True)
    ]
    name = best_quantity(quantities_by_flight, contribution_Nm, cause)
    if name is None:
        return None
    factor, unit = display_unit(quantity_unit(name))
    return _DrawnQuantity(
        quantity_in_words(name), unit, factor * over_all_flights(quantities_by_flight, name)
    )


def _without_mean(values: Floats) -> Floats:
    """Return values less their mean."""
    centred: Floats = values - values.mean()
    return centred
