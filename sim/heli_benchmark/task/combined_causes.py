"""Causes of the catalogue that combine others: the list of a split has their parts."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

PARTS: Mapping[str, tuple[str, ...]] = {"rotor_lag_with_delay": ("rotor_lag", "input_delay")}
"""Effects of the catalogue that combine others; the generator hides the parts."""


def of_parts(id_: str, parameters: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Split a cause that combines several effects.

    Parameters
    ----------
    id_ : str
        The effect.
    parameters : Mapping[str, Any]
        Estimates by full name.

    Returns
    -------
    dict of dict
        Estimates by part and full name; any other effect is returned as it is.
    """
    if id_ not in PARTS:
        return {id_: dict(parameters)}
    of = {"rotor_lag": "lag_s", "input_delay": "delay_s"}
    return {
        part: {f"{part}_s": parameters[f"{id_}_{of[part]}"]}
        for part in PARTS[id_]
        if f"{id_}_{of[part]}" in parameters
    }
