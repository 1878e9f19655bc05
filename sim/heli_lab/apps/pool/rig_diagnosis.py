"""Read the diagnosis of one rig, and remove the prior from its parameter estimates."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from heli_lab.errors import PoolError

MIN_CAUSE_CONFIDENCE: Final = 0.9
"""Confidence from which on a cause counts as present, 0 to 1. By definition, at least nine of ten such causes
are right. A lower value counts causes that no rig has, a higher one misses causes that the flights show
weakly."""
_MIN_INFORMATION_SHARE: Final = 0.05
"""Smallest precision from the flights over the prior's precision for which a parameter of a rig is used.
Below it, the estimate without the prior is a difference of nearly equal numbers."""


@dataclass(frozen=True)
class ParameterEstimate:
    """Estimate or prior of one parameter of a rig."""

    value: float  # value, std: Value and standard error, in `unit`
    std: float
    unit: str  # Unit as in rig files


@dataclass(frozen=True)
class RigDiagnosis:
    """Diagnosis of one rig: parameter estimates and causes of model errors.

    Parameters
    ----------
    label : str
        Name of the rig in messages.
    rig, model : str
        Names of the rig file that gave the prior, and of the model.
    parameters : Mapping of str to ParameterEstimate
        Estimates from the flights alone, of each parameter about which they are informative.
    priors : Mapping of str to ParameterEstimate
        Prior of each parameter.
    causes : Mapping of str to float
        Diagnosed effects with their confidence, 0 to 1.
    undetectable : tuple of str
        Effects that the flights could not show.
    """

    label: str
    rig: str
    model: str
    parameters: Mapping[str, ParameterEstimate]
    priors: Mapping[str, ParameterEstimate]
    causes: Mapping[str, float]
    undetectable: tuple[str, ...]


def read_rig_diagnosis(path: Path) -> RigDiagnosis:
    """Read the JSON file that ``heli-host diagnose --json`` wrote to `path`.

    Raises
    ------
    PoolError
        When the file cannot be read, or is not a diagnosis with parameters of a rig.
    """
    remedy = "give files of heli-host diagnose --json"
    try:
        return _rig_diagnosis_of_json(path, json.loads(path.read_bytes()))
    except OSError as error:
        raise PoolError(f"{path}: {error.strerror}", remedy) from None
    except (json.JSONDecodeError, UnicodeDecodeError):
        raise PoolError(f"{path} is not JSON", remedy) from None
    except (KeyError, TypeError, AttributeError, ValueError):
        raise PoolError(
            f"{path} is not a diagnosis with parameters of a rig",
            "give files that this version of heli-host diagnose --json wrote for flights in the air",
        ) from None


def _rig_diagnosis_of_json(path: Path, content: Mapping[str, Any]) -> RigDiagnosis:
    """Convert the `content` of the file at `path`; invalid content raises one of Python's errors."""
    parameters, priors, rig = {}, {}, content["rig"]
    for name, entry in rig["numbers"].items():
        prior_value, prior_std = float(entry["prior"]["value"]), float(entry["prior"]["std"])
        priors[name] = prior = ParameterEstimate(prior_value, prior_std, str(entry["unit"]))
        from_flights = without_prior(float(entry["value"]), float(entry["std"]), prior)
        if from_flights is not None:
            parameters[name] = from_flights
    return RigDiagnosis(
        label=path.stem,
        rig=str(rig["name"]),
        model=str(rig["model"]),
        parameters=parameters,
        priors=priors,
        causes={str(cause["effect"]): float(cause["confidence"]) for cause in content["causes"]},
        undetectable=tuple(map(str, content["undetectable"])),
    )


def without_prior(value: float, std: float, prior: ParameterEstimate) -> ParameterEstimate | None:
    """Remove the prior from an estimate, because all rigs of a type share this prior.

    The posterior density is the product of the prior and the marginal likelihood of the flights. For normal
    densities, the precision of the flights is the posterior precision minus the prior precision.
    """
    posterior_precision, prior_precision = std**-2.0, prior.std**-2.0
    precision = posterior_precision - prior_precision
    if precision < _MIN_INFORMATION_SHARE * prior_precision:
        return None
    value_from_flights = (value * posterior_precision - prior.value * prior_precision) / precision
    return ParameterEstimate(value_from_flights, precision**-0.5, prior.unit)
