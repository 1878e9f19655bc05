"""Draw the parameters of rigs, and the sizes of effects, at random."""

from __future__ import annotations

import fnmatch
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from heli_sim.rig import Rig

from heli_lab.apps.campaign.case import Cell
from heli_lab.errors import CampaignError

TOLERANCES: Final = "tolerances"
PREFIX: Final = "drawn_"
"""Beginning of the names of the table's columns with drawn values."""
_FORMS: Final = ("share", "factor", "range")


@dataclass(frozen=True)
class RigDraw:
    """A rig and effects with parameters drawn at random from one seed."""

    rig: Rig  # The rig with the drawn parameters
    effects: tuple[str, ...]  # Effects as the command line spells them, each with its size
    numbers: Mapping[str, float]
    """The drawn values: by the rig file's name of a parameter, in its unit, or by the name of an effect."""

    @property
    def row(self) -> dict[str, Cell]:
        """Columns of the table: ``drawn_thrust_gain``, ``drawn_rotor_lag``."""
        return {f"{PREFIX}{name}": value for name, value in self.numbers.items()}


def draw_rig(
    rig: Rig, effects: Sequence[str], draw: str | Mapping[str, Mapping[str, Any]], seed: int
) -> RigDraw:
    """Draw parameters of a rig and sizes of effects at random."""
    random = np.random.default_rng([seed, 17])
    if isinstance(draw, str):
        if draw != TOLERANCES:
            raise CampaignError(f'unknown draw = "{draw}"', f'write draw = "{TOLERANCES}", or a table')
        values = _draw_within_tolerances(rig, random)
        return RigDraw(rig.replace(**values), tuple(effects), values)
    values, sizes = {}, {}
    effects_with_sizes = list(effects)
    for pattern, distribution in draw.items():
        check_distribution(pattern, distribution)
        names = [name for name in rig if fnmatch.fnmatchcase(name, pattern)]
        for name in names:
            values[name] = _draw_from_distribution(rig[name].value, distribution, random)
        if names:
            continue
        if pattern not in effects_with_sizes or "range" not in distribution:
            raise CampaignError(
                f"[draw] {pattern}: no number of rig {rig.name} and no effect of the case without a size",
                "correct the name; an effect needs a range",
            )
        # Rounded by the text of the effect; the table must state the rounded size.
        size = f"{_draw_from_distribution(0.0, distribution, random):.6g}"
        effects_with_sizes[effects_with_sizes.index(pattern)] = f"{pattern}={size}"
        sizes[pattern] = float(size)
    return RigDraw(rig.replace(**values), tuple(effects_with_sizes), {**values, **sizes})


def _draw_within_tolerances(rig: Rig, random: np.random.Generator) -> dict[str, float]:
    """Draw every parameter of a rig that has a tolerance from a normal distribution; return them by name."""
    values = {}
    for name, number in rig.items():
        if number.tolerance > 0.0:
            value = number.value + 0.5 * number.tolerance * float(random.standard_normal())
            values[name] = value if Rig.may_be_negative(name) else abs(value)
    return values


def check_distribution(name: str, distribution: object) -> None:
    """Check the `distribution` of the parameter `name` in a campaign file."""
    if (
        not isinstance(distribution, Mapping)
        or len(distribution) != 1
        or next(iter(distribution)) not in _FORMS
    ):
        raise CampaignError(
            f"[draw] {name}: it needs exactly one of {', '.join(_FORMS)}",
            "write, for example, { share = 0.2 }",
        )
    form, value = next(iter(distribution.items()))
    numbers = value if isinstance(value, list | tuple) else [value]
    valid = all(isinstance(number, int | float) and not isinstance(number, bool) for number in numbers)
    if form == "share":
        valid = valid and len(numbers) == 1 and 0.0 <= numbers[0] < 1.0
    elif form == "factor":
        valid = valid and len(numbers) == 1 and numbers[0] >= 1.0
    else:
        valid = valid and len(numbers) == 2 and numbers[0] <= numbers[1]
    if not valid:
        raise CampaignError(
            f"[draw] {name}: {form} = {value!r} is invalid",
            "give a share from 0 to 1, a factor of at least 1, or a range of two numbers",
        )


def _draw_from_distribution(
    value: float, distribution: Mapping[str, Any], random: np.random.Generator
) -> float:
    """Draw a number from a `distribution` about the nominal `value`."""
    if "share" in distribution:
        share = distribution["share"]
        return value * (1.0 + float(random.uniform(-share, share)))
    if "factor" in distribution:
        return value * float(distribution["factor"] ** random.uniform(-1.0, 1.0))
    low, high = distribution["range"]
    return float(random.uniform(low, high))
