"""One machine as its diagnosis has it."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from heli_lab.errors import PoolError

SURE: Final = 0.9
"""Confidence from which on a cause counts as found: of those so sure, nine of ten and more are right on the
blind set (docs/diagnosing.md). Lower: what is on no machine is counted. Higher: causes of which the flights
show little are taken for absent."""
_LEAST_SHARE: Final = 0.05
"""Least that flights must add to what was known of a number, as a share of the prior's precision, for the
machine to have a say: below it their own estimate is a difference of nearly equal numbers."""


@dataclass(frozen=True)
class NumberEstimate:
    """A number of a machine by its flights alone.

    Parameters
    ----------
    value, std : float
        Value and standard error.
    unit : str
        Of both, spelled as in rig files.
    """

    value: float
    std: float
    unit: str


@dataclass(frozen=True)
class Machine:
    """What a diagnosis says of a machine.

    Parameters
    ----------
    label : str
        For messages.
    rig, model : str
        Name of the rig that was known beforehand, and of the model.
    numbers : Mapping of str to NumberEstimate
        Numbers that its flights tell something of.
    priors : Mapping of str to NumberEstimate
        What was known of each number beforehand.
    causes : Mapping of str to float
        Causes that were named, with their confidence.
    hidden : tuple of str
        Effects that its flights could not have shown.
    """

    label: str
    rig: str
    model: str
    numbers: Mapping[str, NumberEstimate]
    priors: Mapping[str, NumberEstimate]
    causes: Mapping[str, float]
    hidden: tuple[str, ...]


def read_machine(path: Path) -> Machine:
    """Read the JSON file that ``heli-host diagnose --json`` wrote to `path`.

    Raises
    ------
    PoolError
        When it cannot be read, is no diagnosis, or one without numbers, such as one in which nothing flew.
    """
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise PoolError(f"{path}: {error.strerror}", "give files of heli-host diagnose --json") from None
    except ValueError:
        raise PoolError(f"{path} is no JSON", "give files of heli-host diagnose --json") from None
    try:
        return _machine(path, content)
    except (KeyError, TypeError, AttributeError, ValueError):
        raise PoolError(
            f"{path} is no diagnosis with numbers of a rig",
            "give files of heli-host diagnose --json, written by this version from flights that flew",
        ) from None


def _machine(path: Path, content: Mapping[str, Any]) -> Machine:
    numbers, priors = {}, {}
    for name, number in content["rig"]["numbers"].items():
        prior = NumberEstimate(
            float(number["prior"]["value"]), float(number["prior"]["std"]), str(number["unit"])
        )
        priors[name] = prior
        alone = by_flights_alone(float(number["value"]), float(number["std"]), prior)
        if alone is not None:
            numbers[name] = alone
    causes = {str(cause["effect"]): float(cause["confidence"]) for cause in content["causes"]}
    rig = content["rig"]
    hidden = tuple(map(str, content["undetectable"]))
    return Machine(path.stem, str(rig["name"]), str(rig["model"]), numbers, priors, causes, hidden)


def by_flights_alone(value: float, std: float, prior: NumberEstimate) -> NumberEstimate | None:
    """Take the prior out of an estimate: machines share it, and their flights do not.

    The estimate's density is the prior's times the flights' likelihood, everything else integrated out: of
    normal densities precisions subtract.

    Parameters
    ----------
    value, std : float
        Estimate with its standard error, in the prior's unit.
    prior : NumberEstimate
        What was known before the flights.

    Returns
    -------
    Estimate or None
        None where the flights say next to nothing.
    """
    before = prior.std**-2.0
    precision = std**-2.0 - before
    if precision < _LEAST_SHARE * before:
        return None
    return NumberEstimate((value * std**-2.0 - prior.value * before) / precision, precision**-0.5, prior.unit)
