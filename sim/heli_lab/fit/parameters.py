"""The vector of free parameters with their priors: shared by all flights, or of a single flight.

A flight is one recording. Parameters of one flight alone, such as the zero of an encoder, make the normal
equations block-sparse (`normal_equations.py`).
"""

from __future__ import annotations

import copy
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from math import inf
from typing import Final, NamedTuple, Protocol

import numpy as np
from heli_host.data.arrays import Floats, Integers

_VAGUE: Final = 1e3
"""Factor on the standard deviation of a prior that is removed: the information of one flight then outweighs
the prior by far. A much larger factor makes information matrices lose digits."""


class PriorDistribution(Protocol):
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


class ValueAndStd(NamedTuple):
    """An estimate and its standard error."""

    value: float
    std: float


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
    """A parameter that is estimated, with its prior.

    Parameters
    ----------
    name : str
        Unique name. If the parameter differs between flights, the label of the flight follows in brackets.
    unit : str
        SI unit.
    prior : PriorDistribution
        Distribution before the flights are seen.
    quantity : str
        Name of the parameter in the model.
    record : int or None
        Number of the flight that the parameter belongs to; None if all flights share it.
    """

    name: str
    unit: str
    prior: PriorDistribution
    quantity: str
    record: int | None = None

    @property
    def is_shared(self) -> bool:
        """Whether all flights share the parameter, because it belongs to the rig."""
        return self.record is None


class ParameterVector:
    """Free parameters of a model in some flights.

    Parameters
    ----------
    parameters : sequence of str
        All parameters of the model.
    values : ndarray (p,)
        Values of these parameters, which hold for those that are not free.
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
        self._index = {name: index for index, name in enumerate(parameters)}
        self.values = values.copy()
        self.quantities = tuple(parameter.quantity for parameter in (*shared, *per_flight))
        self._set_free((*shared, *local), len(labels))

    def _set_free(self, free: tuple[FreeParameter, ...], flights: int) -> None:
        """Set the `free` parameters of a number of `flights`, and the attributes that follow from them."""
        self.free = free
        self.columns: tuple[Integers, ...] = tuple(
            np.array([i for i, parameter in enumerate(free) if parameter.record in (None, index)], int)
            for index in range(flights)
        )
        self._free_index = np.array([self._index[parameter.quantity] for parameter in free], int)
        self.mean: Floats = np.array([parameter.prior.mean for parameter in free])
        self.std: Floats = np.array([parameter.prior.std for parameter in free])

    def with_free(self, free: Sequence[FreeParameter]) -> ParameterVector:
        """Return a vector of other free parameters of the same model.

        Parameters
        ----------
        free : sequence of FreeParameter
            First the shared parameters, then those of single flights.
        """
        other = copy.copy(self)
        other._set_free(tuple(free), len(self.columns))
        return other

    def without_priors(self, names: Collection[str]) -> ParameterVector:
        """Return the same vector with very wide priors of the parameters `names`; the bounds stay."""
        other = copy.copy(self)
        is_removed = np.array([parameter.name in names for parameter in self.free], bool)
        other.std = np.where(is_removed, _VAGUE * self.std, self.std)
        return other

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the free parameters."""
        return tuple(parameter.name for parameter in self.free)

    @property
    def bounds(self) -> tuple[Floats, Floats]:
        """Lower and upper bounds of the free parameters, shape (f,) each."""
        low = np.array([parameter.prior.low for parameter in self.free])
        high = np.array([parameter.prior.high for parameter in self.free])
        return low, high

    @property
    def start(self) -> Floats:
        """Values to start from, within the bounds; shape (f,)."""
        return np.asarray(np.clip(self.values[self._free_index], *self.bounds))

    @property
    def values_by_name(self) -> dict[str, float]:
        """All parameters of the model by name, free ones with the value that they would have if fixed."""
        return dict(zip(self._index, self.values.tolist(), strict=True))

    def by_name(self, theta: Floats) -> dict[str, float]:
        """Return the free parameters `theta`, shape (f,), by name."""
        return dict(zip(self.names, theta.tolist(), strict=True))

    def shared_by_name(self, theta: Floats) -> dict[str, float]:
        """Return the free parameters that all flights share, by their name in the model, from all free
        parameters `theta`, shape (f,).
        """
        return {
            parameter.quantity: value
            for parameter, value in zip(self.free, theta.tolist(), strict=True)
            if parameter.is_shared
        }

    def started_from(self, values: Mapping[str, float]) -> Floats:
        """Return start values, shape (f,): those in `values`, by name of the free parameter; the others from
        `start`.
        """
        start = [values.get(name, value) for name, value in zip(self.names, self.start, strict=True)]
        return np.asarray(np.clip(np.array(start, float), *self.bounds))

    def parameters(self, theta: Floats, index: int = 0) -> Floats:
        """Return all parameters of the model in flight `index`, shape (p,), for the free parameters `theta`,
        shape (f,).
        """
        values = self.values.copy()
        columns = self.columns[index]
        values[self._free_index[columns]] = theta[columns]
        return values
