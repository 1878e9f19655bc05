"""Answer of a method to a case: probabilities of causes, and parameters with standard errors."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Final

from heli_sim.rig import RIG_QUANTITIES

from heli_benchmark.errors import BenchmarkError
from heli_benchmark.task.axis_series import AxisSeries, read_series, series_content
from heli_benchmark.task.json_file import read_json, write_json
from heli_benchmark.task.split import NOTHING, SCHEMA, Causes

_KEYS: Final = {
    *("schema", "probabilities", "parameters"),
    *("equation", "equation_torques", "predicted_flights"),
}
_RIG_PARAMETERS: Final = frozenset(quantity.name for quantity in RIG_QUANTITIES)
_ROUNDING: Final = 1e-6


@dataclass(frozen=True)
class Estimate:
    """An estimated parameter."""

    value: float  # The estimate, in the unit of the causes file
    std: float  # Its standard error


@dataclass(frozen=True)
class Answer:
    """Answer to a case."""

    probabilities: Mapping[str, float]
    """Probability that each cause is hidden, with `nothing` and `unlisted`. A name without an entry has 0.
    Several causes may be hidden together, so that the probabilities need not add up to 1."""
    parameters: Mapping[str, Estimate] = field(default_factory=dict)
    """Estimates by name, of causes or of the rig."""
    equation: str = ""  # An equation in words or symbols, for readers; it is not scored
    equation_torques: Mapping[str, AxisSeries] = field(default_factory=dict)
    """Torques of the unlisted cause along validation flights, by flight, N m; empty if there are none."""
    predicted_flights: Mapping[str, AxisSeries] = field(default_factory=dict)
    """Angles of validation flights, rad, each predicted from the voltages and from the angles up to 1 s
    earlier; empty if the model of the answer predicts."""


def check_answer(content: object, causes: Causes, where: str) -> Answer:
    """Check the content of an answer."""
    if not isinstance(content, Mapping):
        raise BenchmarkError(f"{where}: the answer is not an object", "return a dictionary")
    if unknown := sorted(str(key) for key in content if key not in _KEYS):
        raise BenchmarkError(f"{where}: unknown key '{unknown[0]}'", f"use {', '.join(sorted(_KEYS))}")
    if content.get("schema") != SCHEMA:
        raise BenchmarkError(f"{where}: schema is {content.get('schema')!r}", f"set schema to {SCHEMA}")
    probabilities = content.get("probabilities")
    if not isinstance(probabilities, Mapping) or not probabilities:
        raise BenchmarkError(f"{where}: there are no probabilities", "add an object 'probabilities'")
    _check_probabilities(probabilities, causes, where)
    equation = content.get("equation", "")
    if not isinstance(equation, str):
        raise BenchmarkError(f"{where}: the equation is not text", "give text, or leave the key out")
    parameters = _read_parameters(content.get("parameters", {}), causes, where)
    return Answer(
        {name: float(value) for name, value in probabilities.items()},
        parameters,
        equation,
        read_series(content.get("equation_torques", {}), "Nm", f"{where}: 'equation_torques'"),
        read_series(content.get("predicted_flights", {}), "rad", f"{where}: 'predicted_flights'"),
    )


def _check_probabilities(probabilities: Mapping[Any, Any], causes: Causes, where: str) -> None:
    """Raise BenchmarkError if a name is unknown, or if the probabilities contradict each other."""
    for name, value in probabilities.items():
        if name not in causes.base_rates:
            raise BenchmarkError(f"{where}: unknown cause '{name}'", "choose from causes.json")
        if not _is_number(value) or not 0.0 <= value <= 1.0:
            raise BenchmarkError(
                f"{where}: the probability of '{name}' is {value!r}", "give a number from 0 to 1"
            )
    highest = max((value for name, value in probabilities.items() if name != NOTHING), default=0.0)
    if probabilities.get(NOTHING, 0.0) + highest > 1.0 + _ROUNDING:
        raise BenchmarkError(
            f"{where}: the probabilities of 'nothing' and of a cause add up to more than 1",
            "lower one of them; both cannot be true",
        )


def _read_parameters(content: object, causes: Causes, where: str) -> dict[str, Estimate]:
    """Check and convert the estimates of an answer."""
    if not isinstance(content, Mapping):
        raise BenchmarkError(f"{where}: 'parameters' is not an object", "give value and std by name")
    for name, estimate in content.items():
        if name not in causes.parameter_names and name not in _RIG_PARAMETERS:
            raise BenchmarkError(
                f"{where}: unknown parameter '{name}'", "choose from causes.json or rig.toml"
            )
        if not isinstance(estimate, Mapping) or set(estimate) != {"value", "std"}:
            raise BenchmarkError(f"{where}: '{name}' needs a value and a std", "give both, nothing else")
        value, std = estimate["value"], estimate["std"]
        if not _is_number(value) or not _is_number(std) or std <= 0.0:
            raise BenchmarkError(
                f"{where}: '{name}' has value {value!r} and std {std!r}",
                "give finite numbers and a positive std",
            )
    return {
        name: Estimate(float(estimate["value"]), float(estimate["std"])) for name, estimate in content.items()
    }


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def read_answer(path: Path, causes: Causes) -> Answer:
    """Read and check an answer."""
    return check_answer(read_json(path, "write the answer again"), causes, str(path))


def write_answer(path: Path, answer: Answer) -> None:
    """Write an answer as JSON."""
    write_json(path, answer_content(answer))


def answer_content(answer: Answer) -> dict[str, Any]:
    """Return an answer as the content of its file."""
    return {
        "schema": SCHEMA,
        "probabilities": dict(answer.probabilities),
        "parameters": {name: asdict(estimate) for name, estimate in answer.parameters.items()},
        "equation": answer.equation,
        "equation_torques": series_content(answer.equation_torques, "Nm"),
        "predicted_flights": series_content(answer.predicted_flights, "rad"),
    }


def answer_with(
    causes: Causes, named: Mapping[str, float], parameters: Mapping[str, Estimate] | None = None
) -> dict[str, Any]:
    """Return the content of an answer that gives probabilities for some causes only.

    Other causes keep a share of their base rates: the less certain `named` is, the larger the share.
    """
    # Several causes may be hidden together: a certain cause halves the rates of the others, no more.
    certain = max((value for name, value in named.items() if name != NOTHING), default=0.0)
    share = (1.0 - 0.5 * certain) * (1.0 - named.get(NOTHING, 0.0))
    remaining_rates = {name: rate * share for name, rate in causes.base_rates.items()}
    all_probabilities = {
        **remaining_rates,
        **{name: min(max(value, 0.0), 1.0) for name, value in named.items()},
    }
    if named and NOTHING not in named:
        all_probabilities[NOTHING] = math.prod(1.0 - value for value in named.values())
    highest = max(value for name, value in all_probabilities.items() if name != NOTHING)
    all_probabilities[NOTHING] = min(all_probabilities[NOTHING], 1.0 - highest)
    return answer_content(Answer(all_probabilities, parameters or {}))
