"""Rigs whose parameters differ from their file by random draws from a seed."""

from __future__ import annotations

import fnmatch
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from heli_sim.rig import Rig

from heli_lab.campaign.case import Cell
from heli_lab.errors import CampaignError

TOLERANCES: Final = "tolerances"
PREFIX: Final = "drawn_"
"""Begins the names of the table's columns for what was drawn."""
_FORMS: Final = ("share", "factor", "range")


@dataclass(frozen=True)
class Drawn:
    """A rig and effects with parameters drawn at random from one seed.

    Parameters
    ----------
    effects : tuple of str
        Effects as the command line spells them, each with its size.
    numbers : Mapping of str to float
        Drawn values: by the rig file's name of a parameter, in its unit, or by the name of an effect.
    """

    rig: Rig
    effects: tuple[str, ...]
    numbers: Mapping[str, float]

    @property
    def row(self) -> dict[str, Cell]:
        """Columns of the table: ``drawn_thrust_gain``, ``drawn_rotor_lag``."""
        return {f"{PREFIX}{name}": value for name, value in self.numbers.items()}


def drawn(rig: Rig, effects: Sequence[str], draw: str | Mapping[str, Mapping[str, Any]], seed: int) -> Drawn:
    """Draw a rig and sizes of effects.

    Parameters
    ----------
    rig : Rig
        The rig with its nominal parameters.
    effects : sequence of str
        Effects as the command line spells them. Effects whose size is drawn are given without a size.
    draw : str or mapping
        ``tolerances`` draws every parameter of the rig from a normal distribution whose standard deviation is
        half the tolerance. Otherwise a mapping from the name of a parameter (wildcards allowed) or of an
        effect to one of three distributions. ``share`` is uniform within that share of the value. ``factor``
        is uniform in the logarithm, from the value divided by the factor to the value times the factor.
        ``range`` is uniform between two values in the parameter's unit.
    seed : int
        Seed of the random generator; equal seeds draw equal values.

    Raises
    ------
    CampaignError
        When a name matches nothing, or a parameter cannot be drawn as `draw` states.
    """
    random = np.random.default_rng([seed, 17])
    values: dict[str, float] = {}
    sized = list(effects)
    if isinstance(draw, str):
        if draw != TOLERANCES:
            raise CampaignError(f'unknown draw = "{draw}"', f'write draw = "{TOLERANCES}", or a table')
        for name, number in rig.items():
            if number.tolerance > 0.0:
                value = number.value + 0.5 * number.tolerance * float(random.standard_normal())
                values[name] = value if Rig.may_be_negative(name) else abs(value)
        return Drawn(rig.replace(**values), tuple(sized), values)
    sizes: dict[str, float] = {}
    for pattern, how in draw.items():
        check_form(pattern, how)
        names = [name for name in rig if fnmatch.fnmatchcase(name, pattern)]
        for name in names:
            values[name] = _draw(rig[name].value, how, random)
        if names:
            continue
        if pattern not in sized or "range" not in how:
            raise CampaignError(
                f"[draw] {pattern}: no number of rig {rig.name} and no effect of the case without a size",
                "correct the name; an effect needs a range",
            )
        text = f"{_draw(0.0, how, random):.6g}"
        sized[sized.index(pattern)], sizes[pattern] = f"{pattern}={text}", float(text)
    return Drawn(rig.replace(**values), tuple(sized), {**values, **sizes})


def check_form(name: str, how: object) -> None:
    """Check that the parameter `name` can be drawn: `how` is a table with one distribution. Otherwise raise a
    CampaignError.
    """
    if not isinstance(how, Mapping) or len(how) != 1 or next(iter(how)) not in _FORMS:
        raise CampaignError(
            f"[draw] {name}: it needs exactly one of {', '.join(_FORMS)}",
            "write, for example, { share = 0.2 }",
        )
    form, value = next(iter(how.items()))
    numbers = value if isinstance(value, list | tuple) else [value]
    plain = all(isinstance(number, int | float) and not isinstance(number, bool) for number in numbers)
    good = {
        "share": len(numbers) == 1 and plain and 0.0 <= numbers[0] < 1.0,
        "factor": len(numbers) == 1 and plain and numbers[0] >= 1.0,
        "range": len(numbers) == 2 and plain and numbers[0] <= numbers[1],
    }[form]
    if not good:
        raise CampaignError(
            f"[draw] {name}: {form} = {value!r} is invalid",
            "give a share from 0 to 1, a factor of at least 1, or a range of two numbers",
        )


def _draw(value: float, how: Mapping[str, Any], random: np.random.Generator) -> float:
    if "share" in how:
        return value * (1.0 + float(random.uniform(-how["share"], how["share"])))
    if "factor" in how:
        return value * float(how["factor"] ** random.uniform(-1.0, 1.0))
    low, high = how["range"]
    return float(random.uniform(low, high))
