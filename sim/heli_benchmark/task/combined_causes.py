"""Causes of the catalogue that combine two others, such as a lag together with a delay.

A benchmark case hides the two parts, so the estimates of a combined cause are split before they are scored.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

PARTS: Mapping[str, tuple[str, ...]] = {"rotor_lag_with_delay": ("rotor_lag", "input_delay")}
"""Effects of the catalogue that combine others; the generator hides the parts."""
_SUFFIXES: Final = {"rotor_lag": "lag_s", "input_delay": "delay_s"}


def of_parts(id_: str, parameters: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Split a cause that combines several effects."""
    if id_ not in PARTS:
        return {id_: dict(parameters)}
    # Name of the parameter of each part within the combined cause.
    names = {part: f"{id_}_{suffix}" for part, suffix in _SUFFIXES.items()}
    return {part: {f"{part}_s": parameters[names[part]]} for part in PARTS[id_] if names[part] in parameters}
