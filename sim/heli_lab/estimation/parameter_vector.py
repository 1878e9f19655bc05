"""The vector of free parameters with their priors: shared by all flights, or of a single flight.

A flight is one recording. Parameters of one flight alone, such as the zero of an encoder, make the normal
equations block-sparse (`arrowhead.py`).
"""

from __future__ import annotations

import copy
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from math import inf
from typing import Final, Protocol

import numpy as np
from heli_host.arrays import Floats, Integers

_VAGUE: Final = 1e3
"""Factor on the standard deviation of a prior that is removed: the information of one flight is larger by far
than what is left of it. Much larger: information matrices lose digits."""


class Prior(Protocol):
    """Attributes of a `NormalPrior`."""

    @property
    def mean(self) -> float:
        """Mean, in the parameter's unit."""

    @property
    def std(self) -> float:
        """Standard deviation."""

    @property
    def low(self) -> float:
        """Lower bound."""

    @property
    def high(self) -> float:
        """Upper bound."""


@dataclass(frozen=True)
class NormalPrior:
    """Normal prior of a parameter, within bounds.

    Parameters
    ----------
    mean, std : float
        In the parameter's unit.
    low, high : float
        Bounds.
    """

    mean: float
    std: float
    low: float = -inf
    high: float = inf


@dataclass(frozen=True)
class FreeParameter:
    """A parameter to be estimated.

    Parameters
    ----------
    name : str
        Its name; one that differs between several flights has the flight's label in brackets.
    unit : str
        SI unit.
    quantity : str
        Its name in the model.
    record : int or None
        The flight that it belongs to; None for all.
    """

    name: str
    unit: str
    prior: Prior
    quantity: str
    record: int | None = None


class ParameterVector:
    """Free parameters of a model in some flights.

    Parameters
    ----------
    parameters : sequence of str
        All parameters of the model.
    values : ndarray (p,)
        Their values where they are not free.
    shared : sequence of FreeParameter
        Free parameters with one value for all flights.
    per_flight : sequence of FreeParameter
        Free parameters with a separate value in each flight.
    labels : sequence of str
        Names of the flights.

    Attributes
    ----------
    free : tuple of FreeParameter
        All free parameters: first the shared ones, then those of each flight.
    quantities : tuple of str
        Model's names of the free parameters that a flight depends on.
    columns : tuple of ndarray
        For each flight, the indices of the free parameters that it depends on, in the order of `quantities`.
    mean, std : ndarray (f,)
        Means and standard deviations of the priors.
    values : ndarray (p,)
        The argument `values`.
    """

    def __init__(
        self,
        parameters: Sequence[str],
        values: Floats,
        shared: Sequence[FreeParameter],
        per_flight: Sequence[FreeParameter],
        labels: Sequence[str],
    ) -> None:
        local = [
            replace(
                parameter,
                record=index,
                name=f"{parameter.name}[{label}]" if len(labels) > 1 else parameter.name,
            )
            for index, label in enumerate(labels)
            for parameter in per_flight
        ]
        self._names = {name: place for place, name in enumerate(parameters)}
        self.values = values.copy()
        self.quantities = tuple(parameter.quantity for parameter in (*shared, *per_flight))
        self._set_free((*shared, *local), len(labels))

    def _set_free(self, free: tuple[FreeParameter, ...], flights: int) -> None:
        self.free = free
        self.columns: tuple[Integers, ...] = tuple(
            np.array([i for i, parameter in enumerate(free) if parameter.record in (None, index)], int)
            for index in range(flights)
        )
        self._place = np.array([self._names[parameter.quantity] for parameter in free], int)
        self.mean: Floats = np.array([parameter.prior.mean for parameter in free])
        self.std: Floats = np.array([parameter.prior.std for parameter in free])

    def with_free(self, free: Sequence[FreeParameter]) -> ParameterVector:
        """Take other `free` parameters, those of one flight after the shared ones; values stay."""
        other = copy.copy(self)
        other._set_free(tuple(free), len(self.columns))
        return other

    def without_priors(self, names: Collection[str]) -> ParameterVector:
        """Remove the priors of the free parameters `names`; their bounds stay."""
        other = copy.copy(self)
        removed = np.array([parameter.name in names for parameter in self.free], bool)
        other.std = np.where(removed, _VAGUE * self.std, self.std)
        return other

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
        """Values to start from, within the bounds; shape (f,)."""
        result: Floats = np.clip(self.values[self._place], *self.bounds)
        return result

    def by_name(self, theta: Floats) -> dict[str, float]:
        """Return the free parameters `theta`, shape (f,), by name."""
        return dict(zip(self.names, theta.tolist(), strict=True))

    def shared_by_name(self, theta: Floats) -> dict[str, float]:
        """Return those of the free parameters `theta`, shape (f,), that all flights share, by name in the
        model.
        """
        return {
            parameter.quantity: value
            for parameter, value in zip(self.free, theta.tolist(), strict=True)
            if parameter.record is None
        }

    def started_from(self, values: Mapping[str, float]) -> Floats:
        """Start with some `values` by name of the free parameter, within the bounds; shape (f,)."""
        start = [values.get(name, value) for name, value in zip(self.names, self.start, strict=True)]
        result: Floats = np.clip(np.array(start, float), *self.bounds)
        return result

    def parameters(self, theta: Floats, index: int = 0) -> Floats:
        """Complete free parameters `theta`, shape (f,), to all those of the model, shape (p,), for the flight
        of number `index`.
        """
        full = self.values.copy()
        columns = self.columns[index]
        full[self._place[columns]] = theta[columns]
        return full
