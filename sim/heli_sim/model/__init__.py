"""The dynamics of the rig, symbolic in CasADi."""

from __future__ import annotations

from heli_sim.model.base import Model
from heli_sim.model.effect import Effect, Operands, Stage
from heli_sim.model.multibody import MultibodyModel
from heli_sim.model.paper import PaperModel
from heli_sim.model.paper_printed import PaperPrintedModel
from heli_sim.rig.quantity import Quantity

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
