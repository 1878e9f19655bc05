"""The dynamics of the rig, symbolic in CasADi."""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

from heli_sim.errors import PlantError
from heli_sim.model.base import Model
from heli_sim.model.effect import Effect, Operands, Stage
from heli_sim.model.multibody import MultibodyModel
from heli_sim.model.paper import PaperModel, PaperPrintedModel
from heli_sim.rig.schema import Quantity

__all__ = [
    "Effect",
    "Model",
    "MultibodyModel",
    "Operands",
    "PaperModel",
    "PaperPrintedModel",
    "Quantity",
    "Stage",
]


MODELS: Final[Mapping[str, type[Model]]] = MappingProxyType(
    {model.name: model for model in (MultibodyModel, PaperModel, PaperPrintedModel)}
)
"""Every model, by its name."""


def model_named(name: str, effects: tuple[Effect, ...] = ()) -> Model:
    """Make the model `name`, a key of `MODELS`. A PlantError when the name is unknown."""
    if name not in MODELS:
        close = difflib.get_close_matches(name, MODELS, n=1)
        hint = f"did you mean {close[0]}? " if close else ""
        raise PlantError(f"unknown model '{name}'", f"{hint}give one of: {', '.join(MODELS)}")
    return MODELS[name](effects)
