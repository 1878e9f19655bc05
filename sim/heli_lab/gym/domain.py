"""Which rigs and effects episodes are flown with (domain randomisation)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from heli_sim.errors import RigError
from heli_sim.model.effect import Effect
from heli_sim.model.effects import effects_of, parse_effects
from heli_sim.rig import Rig, load_rig

from heli_lab.errors import LearningError

_TRIES: Final = 100
"""Draws until the numbers are a rig that can be; of the shipped rigs nearly every first one is."""
_LEAST: Final = 0.1
"""Least share of its value that a number which may not be negative is drawn as: some are known no better than
that they are small."""


@dataclass(frozen=True)
class Drawn:
    """A rig and its effects, as one episode has them; `texts` are those of its effects that were drawn, as
    command lines spell them.
    """

    rig: Rig
    effects: tuple[Effect, ...]
    texts: tuple[str, ...]


@dataclass(frozen=True)
class Domain:
    """Rigs and effects that episodes draw from, each rig equally likely.

    Parameters
    ----------
    rigs : tuple of str
        Names or TOML files.
    tolerances : float
        How far a rig's numbers are off their values, in the tolerances that its file states: normally
        distributed, cut off at one of these. 0 for the values themselves, 1 for rigs as likely as the file
        says.
    effects : Mapping of str to (float, float)
        Effects by id, each with the range from which its first number is drawn evenly, in its own unit:
        ``{"rotor_lag": (0.05, 0.15)}``.
    chance : float
        Probability with which each of `effects` is there in an episode, 0 to 1.

    Raises
    ------
    LearningError
        A share or a range that is none.
    RigError, EffectError
        There is no such rig or effect, or it may not have such a value.
    """

    rigs: tuple[str, ...] = ("makki2024",)
    tolerances: float = 0.0
    effects: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    chance: float = 1.0

    def __post_init__(self) -> None:
        if not self.rigs:
            raise LearningError("a domain without rigs", "name at least one")
        if not (self.tolerances >= 0.0 and 0.0 <= self.chance <= 1.0):
            raise LearningError(
                f"tolerances={self.tolerances} and chance={self.chance} cannot be",
                "give 0 or more tolerances, and a chance from 0 to 1",
            )
        for name, (low, high) in self.effects.items():
            if not low <= high:
                raise LearningError(f"{name} from {low} to {high} is no range", "give the lower value first")
            parse_effects([f"{name}={low!r}"])
            parse_effects([f"{name}={high!r}"])
        for rig in self.rigs:
            load_rig(rig)

    def draw(self, random: np.random.Generator) -> Drawn:
        """Draw what the next episode flies with.

        Parameters
        ----------
        random : numpy.random.Generator
            Where chance comes from.
        """
        rig = self._rig(random)
        texts = tuple(
            f"{name}={float(random.uniform(low, high))!r}"
            for name, (low, high) in self.effects.items()
            if random.random() < self.chance
        )
        drawn_effects = parse_effects(texts)
        names = {effect.name for effect in drawn_effects}
        return Drawn(
            rig,
            (*(rig_effect for rig_effect in effects_of(rig) if rig_effect.name not in names), *drawn_effects),
            texts,
        )

    def _rig(self, random: np.random.Generator) -> Rig:
        rig = load_rig(self.rigs[int(random.integers(len(self.rigs)))])
        if not self.tolerances:
            return rig
        for _ in range(_TRIES):
            values = {}
            for name, number in rig.items():
                share = float(np.clip(random.normal() / 2.0, -1.0, 1.0))
                value = number.value + self.tolerances * number.tolerance * share
                values[name] = value if rig.may_be_negative(name) else max(value, _LEAST * number.value)
            try:
                return rig.replace(**values)
            except RigError:
                continue
        raise LearningError(
            f"no draw of rig '{rig.name}' within {self.tolerances:g} tolerances can be", "give fewer"
        )
