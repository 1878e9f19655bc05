"""A rig, by its name alone, as a state space for control design."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from heli_sim.model.effects import effects_of, parse_effects
from heli_sim.model.linear import linearise as linearise_model
from heli_sim.model.linear import trim
from heli_sim.model.multibody import MultibodyModel
from heli_sim.model.named import model_named
from heli_sim.rig import Rig, load_rig

if TYPE_CHECKING:
    import control


def linearise(
    rig: str | Path | Rig = "makki2024",
    *,
    elevation_deg: float = 0.0,
    effects: Sequence[str] = (),
    model: str = "",
) -> control.StateSpace:
    """Linearise a rig about hover, with exact derivatives.

    Parameters
    ----------
    rig : str, Path or Rig
        A name such as ``makki2024``, a TOML file, or a rig already read. Effects that its file states count.
    elevation_deg : float
        Elevation at which it hovers [deg].
    effects : sequence of str
        Further effects, such as ``rotor_lag=0.1``; their states follow the rig's six.
    model : str
        ``multibody``, ``paper`` or ``paper_printed``; empty for the one that the rig's file names, or
        ``multibody``.

    Returns
    -------
    control.StateSpace
        In deviations from hover. States: ``elevation_rad``, ``pitch_rad``, ``travel_rad``, their rates
        [rad/s], then those of effects. Inputs: ``front_V``, ``back_V``. Outputs: the three angles that the
        encoders see [rad].

    Raises
    ------
    RigError, EffectError, PlantError
        There is no such rig, effect or model, or the rig cannot hover there.

    Examples
    --------
    >>> import control, heli_lab
    >>> plant = heli_lab.linearise("makki2024")
    >>> pitch = plant["pitch_rad", "front_V"]
    """
    loaded = rig if isinstance(rig, Rig) else load_rig(rig)
    given_effects = parse_effects(tuple(effects))
    names = {effect.name for effect in given_effects}
    stated = tuple(effect for effect in effects_of(loaded) if effect.name not in names)
    chosen = model_named(model or loaded.model or MultibodyModel.name, stated + given_effects)
    return linearise_model(chosen, loaded, trim(chosen, loaded, float(np.deg2rad(elevation_deg))))
