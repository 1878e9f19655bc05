"""Names of all causes with their base rates, parameters and meanings, for the causes file of a split."""

from __future__ import annotations

from typing import Any

from heli_sim.model.effects import catalogue

from heli_benchmark.cases.published import base_rates
from heli_benchmark.task.split import NOTHING, UNLISTED


def causes_content() -> dict[str, Any]:
    """Return the causes by name, as the causes file has them."""
    kinds, content = catalogue(), {}
    for name, rate in base_rates().items():
        meaning = {NOTHING: "nothing is hidden", UNLISTED: "a cause that this list does not have"}.get(name)
        spec = None if meaning else kinds[name]
        content[name] = {
            "base_rate": round(rate, 6),
            "meaning": meaning if spec is None else spec.equation,
            "parameters": {}
            if spec is None
            else {quantity.name: quantity.unit for quantity in spec.parameters},
        }
    return content
