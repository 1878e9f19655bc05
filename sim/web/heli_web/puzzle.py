"""A page that hides an effect, and the seal by which the answer is checked later."""

from __future__ import annotations

from typing import Any

from heli_host.data.log.blind import Truth
from heli_sim.model import model_named
from heli_sim.model.base import Model
from heli_sim.model.effect import Effect
from heli_sim.rig import Rig

from heli_web.facts import plant_facts


def hidden_facts(effects: tuple[Effect, ...], rig: Rig, truth: Truth) -> dict[str, Any]:
    """Return the plant of a puzzle. Its hidden parameters have numbers as names, and fixed values."""
    model: Model = model_named(rig.model or "multibody", effects)
    plant = plant_facts(model)
    values = dict(zip(model.parameter_names, model.parameter_values(rig), strict=True))
    hidden = [quantity.name for effect in model.effects for quantity in effect.parameters]
    plain = {name: f"number {index}" for index, name in enumerate(hidden, 1)}
    plant["parameters"] = [plain.get(name, name) for name in plant["parameters"]]
    plant["delay"] = plain.get(plant["delay"], "")
    parameters = [
        {"name": plain[name], "symbol": plain[name], "typical": float(values[name])} for name in hidden
    ]
    return {"sealed": truth.digest, "effect": "hidden", "hidden": {"plant": plant, "parameters": parameters}}
