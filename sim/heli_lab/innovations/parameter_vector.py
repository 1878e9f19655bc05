"""What is estimated of a model: free parameters with their priors, shared by all flights or one a flight."""

from __future__ import annotations

import copy
import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from heli_host.arrays import Floats
from heli_sim.model.base import Model
from heli_sim.model.parts import AXES
from heli_sim.rig import Prior, Rig

from heli_lab.identify import Record
from heli_lab.identify.free import PER_FLIGHT, FreeParameter, free_parameters, rig_prior

TORQUE_STD_Nm: Final = dict(zip((f"torque_{axis}" for axis in AXES), (0.02, 0.01, 0.01), strict=True))
"""Prior standard deviation of the constant torque about each axis that every flight has of its own: what an
unlevel table, a cable or a draught leave. By judgement, of the order of the weather. Smaller: a rig whose
balance moves from flight to flight bends its other numbers. Larger: elevation's hides in the masses."""

_VAGUE: Final = 1e3
"""How many times wider a prior is that says next to nothing: a flight's own information is larger by far."""


class ParameterVector:
    """Free parameters of a `model` on a `rig` in some flights.

    Parameters
    ----------
    model : Model
        The model, with its effects.
    rig : Rig
        Values and priors of its numbers.
    records : sequence of Record
        The flights.
    fixed : Mapping[str, float], optional
        Values of parameters that are not estimated.

    Attributes
    ----------
    free : tuple of FreeParameter
        Those that all flights share first, then each flight's own.
    quantities : tuple of str
        Names in the model of those that a flight depends on.
    columns : tuple of ndarray
        For each flight, which free parameters it depends on, in the order of `quantities`.
    """

    def __init__(
        self, model: Model, rig: Rig, records: Sequence[Record], fixed: Mapping[str, float] | None = None
    ) -> None:
        self.model, self.rig = model, rig
        constants = {name: _torque_prior(rig, name) for name in TORQUE_STD_Nm}
        wanted = [
            parameter
            for parameter in free_parameters(model, rig, None, {})
            if parameter.quantity not in constants
        ]
        per_flight = [parameter for parameter in wanted if parameter.quantity in PER_FLIGHT]
        shared = [
            parameter
            for parameter in wanted
            if parameter.quantity not in PER_FLIGHT and parameter.quantity not in (fixed or {})
        ]
        per_flight += [FreeParameter(name, "N m", prior, name) for name, prior in constants.items()]
        several = len(records) > 1
        local = [
            replace(
                parameter,
                record=index,
                name=f"{parameter.name}[{record.label}]" if several else parameter.name,
            )
            for index, record in enumerate(records)
            for parameter in per_flight
        ]
        self.free: tuple[FreeParameter, ...] = (*shared, *local)
        self.quantities = tuple(parameter.quantity for parameter in (*shared, *per_flight))
        self.columns = tuple(
            np.array([i for i, parameter in enumerate(self.free) if parameter.record in (None, index)], int)
            for index in range(len(records))
        )
        names = [quantity.name for quantity in model.parameters]
        self._base: Floats = model.parameter_values(rig)
        for name, value in (fixed or {}).items():
            self._base[names.index(name)] = value
        self._place = np.array([names.index(parameter.quantity) for parameter in self.free], int)
        self._stack_priors()

    def _stack_priors(self) -> None:
        """Lay out the priors of what is free."""
        self.mean: Floats = np.array([parameter.prior.mean for parameter in self.free])
        self.std: Floats = np.array([parameter.prior.std for parameter in self.free])

    def without_priors(self, names: Collection[str]) -> ParameterVector:
        """The same, with next to nothing known beforehand of the free parameters `names` but their bounds."""
        less = copy.copy(self)
        less.free = tuple(
            replace(parameter, prior=replace(parameter.prior, std=_VAGUE * parameter.prior.std))
            if parameter.name in names
            else parameter
            for parameter in self.free
        )
        less._stack_priors()
        return less

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the free parameters."""
        return tuple(parameter.name for parameter in self.free)

    @property
    def bounds(self) -> tuple[Floats, Floats]:
        """Lowest and highest values, each of shape (f,)."""
        return np.array([parameter.prior.low for parameter in self.free]), np.array(
            [parameter.prior.high for parameter in self.free]
        )

    @property
    def start(self) -> Floats:
        """Values of rig and effects, within the bounds; shape (f,)."""
        result: Floats = np.clip(self._base[self._place], *self.bounds)
        return result

    def parameters(self, theta: Floats, index: int) -> Floats:
        """Complete free parameters `theta`, shape (f,), to all those of the model, shape (p,), for the flight
        of number `index`.
        """
        full = self._base.copy()
        full[self._place[self.columns[index]]] = theta[self.columns[index]]
        return full


def _torque_prior(rig: Rig, name: str) -> Prior:
    """What is known beforehand of one flight's constant torque: as the rig file has it, and what differs from
    flight to flight.
    """
    stated = rig_prior(rig, name) if name in rig and rig[name].tolerance > 0 else Prior(0.0, 0.0)
    return Prior(stated.mean, math.hypot(stated.std, TORQUE_STD_Nm[name]))
