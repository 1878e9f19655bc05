"""Makes the plant of a simulation from its options: rig, model and effects."""

from __future__ import annotations

from heli_sim.model.effects import effects_with
from heli_sim.model.multibody import MultibodyModel
from heli_sim.model.named import model_named
from heli_sim.plant import Plant
from heli_sim.rig import load_rig
from heli_sim.sil.options import SilOptions


def plant_of(options: SilOptions) -> Plant:
    """Make a plant of rig, model and effects; its random numbers are drawn from the seed of the options.

    The rig's file may name the model whose parameters it holds, and effects; options come before both. A
    RigError, EffectError or PlantError when one of the three is unknown, unreadable or has an invalid value.
    """
    rig = load_rig(options.rig)
    effects = effects_with(rig, options.effects, options.effect_files)
    model = model_named(options.model or rig.model or MultibodyModel.name, effects)
    return Plant(model, rig, options.seed)
