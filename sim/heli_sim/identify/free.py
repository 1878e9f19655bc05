"""Which parameters are to be found, and what is known of them beforehand."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from heli_sim.errors import IdentifyError
from heli_sim.model.base import Model
from heli_sim.rig import Prior, Rig

NOT_FREE: Final = frozenset({"g"})
"""Numbers with a tolerance that no flight needs to find: gravity is known better than any of the masses."""

PER_FLIGHT: Final = ("offset_elevation", "offset_pitch")
"""Numbers that are another in each flight, because encoders are zeroed each time the board starts."""


@dataclass(frozen=True)
class FreeParameter:
    """A parameter to be found.

    Parameters
    ----------
    name : str
        Its name; one that is another in each of several flights has the flight's label in brackets.
    unit : str
        Its unit.
    prior : Prior
        What is known of it before the flight.
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


def free_parameters(
    model: Model, rig: Rig, free: Sequence[str] | None, priors: Mapping[str, Prior]
) -> tuple[FreeParameter, ...]:
    """Choose the free parameters of a model.

    Parameters
    ----------
    model : Model
        The model.
    rig : Rig
        Gives priors.
    free : sequence of str or None
        Names; None for every number of the rig that the model uses and that has a tolerance, gravity
        excepted, and every parameter of the model's effects that has a prior.
    priors : Mapping[str, Prior]
        Instead of the rig's and the effects'.

    Returns
    -------
    tuple of FreeParameter
        In the order given, or in the model's.

    Raises
    ------
    IdentifyError
        When a name is unknown, or nothing is known of it beforehand.
    """
    known = {quantity.name: quantity for quantity in model.parameters}
    given = {name: prior for effect in model.effects for name, prior in effect.priors.items()} | dict(priors)
    if free is None:
        free = [
            name
            for name in known
            if name in given or (name in rig and rig[name].tolerance > 0 and name not in NOT_FREE)
        ]
    parameters = []
    for name in dict.fromkeys(free):
        if name not in known:
            raise IdentifyError(
                f"the model '{model.name}' has no parameter '{name}'; names: {', '.join(known)}"
            )
        if name not in given and (name not in rig or rig[name].tolerance == 0):
            raise IdentifyError(
                f"nothing is known of '{name}' beforehand; give it a tolerance in the rig file, or fix it"
            )
        parameters.append(
            FreeParameter(name, known[name].unit, given.get(name) or rig_prior(rig, name), name)
        )
    return tuple(parameters)


def rig_prior(rig: Rig, name: str) -> Prior:
    """Prior of a rig's number.

    Parameters
    ----------
    rig : Rig
        The rig.
    name : str
        Name of the number.

    Returns
    -------
    Prior
        Normal, with half the tolerance as its standard deviation; bounded by 0 where the number cannot be
        negative.
    """
    number = rig[name]
    low = -np.inf if rig.may_be_negative(name) else 0.0
    return Prior(number.value, 0.5 * number.tolerance, low)
