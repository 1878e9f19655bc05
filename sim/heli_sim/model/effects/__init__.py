"""Effects that extend a model, in files by subject, and the catalogue of all effects."""

from __future__ import annotations

from heli_sim.model.effects.catalogue import (
    catalogue,
    effect_numbers,
    effects_of,
    effects_with,
    parse_effects,
)
from heli_sim.model.effects.lags import RotorLag, RotorSpeedLag
from heli_sim.model.effects.spec import ChangeSpec, EffectFamily, EffectSpec, Parameter

__all__ = [
    "ChangeSpec",
    "EffectFamily",
    "EffectSpec",
    "Parameter",
    "RotorLag",
    "RotorSpeedLag",
    "catalogue",
    "effect_numbers",
    "effects_of",
    "effects_with",
    "parse_effects",
]
