"""Domain randomisation: draw the rig and the effects of each episode."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from heli_sim.errors import RigError
from heli_sim.model.effect import Effect
from heli_sim.model.effects import effects_with, parse_effects
from heli_sim.rig import Rig, load_rig

from heli_lab.errors import LearningError

_MAX_DRAWS: Final = 100
"""Largest number of draws until the parameters form a valid rig; for shipped rigs the first one usually
does."""
_MIN_SHARE: Final = 0.1
"""Smallest drawn value of a parameter that may not be negative, as a share of its nominal value. The
tolerance of some parameters exceeds their value."""


@dataclass(frozen=True)
class EpisodeRig:
    """Rig and effects of one episode."""

    rig: Rig  # The rig with its drawn parameters
    effects: tuple[Effect, ...]  # Effects of the rig file and of the domain
    texts: tuple[str, ...]
    """Effects of the domain in the notation of the command line, such as ``rotor_lag=0.1``."""


@dataclass(frozen=True)
class Domain:
    """Distribution of rigs and effects over episodes; each rig is equally likely.

    Parameters
    ----------
    rigs : tuple of str
        Names or TOML files of rigs.
    tolerances : float
        Scale of the parameters' deviations. With 1, a deviation is normal with half a tolerance of the rig
        file as standard deviation, and is clipped at one tolerance. 0 gives the nominal parameters.
    effects : Mapping of str to (float, float)
        Range of the first parameter of each effect, in its unit; the value is drawn uniformly. An example is
        ``{"rotor_lag": (0.05, 0.15)}``.
    chance : float
        Probability of each effect in an episode, 0 to 1.

    Raises
    ------
    LearningError
        When a scale, a probability or a range is invalid.
    RigError, EffectError
        When a rig or an effect is unknown, or a value of an effect is invalid.
    """

    rigs: tuple[str, ...] = ("makki2024",)
    tolerances: float = 0.0
    effects: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    chance: float = 1.0

    def __post_init__(self) -> None:
        if not self.rigs:
            raise LearningError("the domain has no rigs", "give at least one")
        if not (self.tolerances >= 0.0 and 0.0 <= self.chance <= 1.0):
            raise LearningError(
                f"tolerances={self.tolerances} and chance={self.chance} are invalid",
                "give tolerances of 0 or more, and a chance from 0 to 1",
            )
        for name, (low, high) in self.effects.items():
            if not low <= high:
                raise LearningError(
                    f"{name} from {low} to {high} is not a range", "give the smaller value first"
                )
            parse_effects([f"{name}={low!r}"])
            parse_effects([f"{name}={high!r}"])
        for rig in self.rigs:
            load_rig(rig)

    def draw(self, random: np.random.Generator) -> EpisodeRig:
        """Draw the rig and the effects of the next episode with the generator `random`."""
        rig = self._draw_flyable_rig(random)
        texts = tuple(
            f"{name}={float(random.uniform(low, high))!r}"
            for name, (low, high) in self.effects.items()
            if random.random() < self.chance
        )
        return EpisodeRig(rig, effects_with(rig, texts), texts)

    def _draw_flyable_rig(self, random: np.random.Generator) -> Rig:
        """Draw one of the rigs and its parameters; draw again if the parameters do not form a valid rig."""
        rig = load_rig(self.rigs[int(random.integers(len(self.rigs)))])
        if not self.tolerances:
            return rig
        for _ in range(_MAX_DRAWS):
            values = {}
            for name, number in rig.items():
                share = float(np.clip(random.normal() / 2.0, -1.0, 1.0))
                value = number.value + self.tolerances * number.tolerance * share
                values[name] = value if rig.may_be_negative(name) else max(value, _MIN_SHARE * number.value)
            try:
                return rig.replace(**values)
            except RigError:
                continue
        raise LearningError(
            f"no draw of rig '{rig.name}' within {self.tolerances:g} tolerances is valid", "lower tolerances"
        )
