"""What may change of a rig in flight: hypotheses, as derivatives by numbers of the effects' catalogue."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from heli_sim.model.base import Effect, Model
from heli_sim.model.effects import catalogue
from heli_sim.model.effects.spec import format_estimate
from heli_sim.model.parts import AXES

SUPPLY: Final = "supply"
"""Stands for the voltages of both motors among the numbers that a change is a derivative by."""


SCALES: Final = {f"encoder_scale_{axis}": axis for axis in AXES}
"""Stand for the counts of an encoder per turn, by number and axis. From its onset on an encoder adds a share
of each turn to what it shows; until then it was right, so its angle does not jump."""


@dataclass(frozen=True)
class Change:
    """Something that is otherwise from a moment on.

    Parameters
    ----------
    id : str
        Effect of the catalogue, or what a step of it is called.
    numbers : tuple of str
        Parameters of the extended model by which it is a derivative, one or two; `SUPPLY` for a share of both
        voltages, one of `SCALES` for a share of an encoder's counts. Of several in one entry, joined by
        ``+``, each changes alike.
    is_ramp : bool
        Whether it grows with the time since its onset, at a constant rate.
    non_negative : bool
        Whether its first number cannot be negative.
    sizes : tuple of float
        Prior standard deviation of each number, SI: what such changes usually are. It is what a size that
        could be anything costs a hypothesis, so that one which may be anything does not win by that.
    unit : str
        Of the first number, as `format_estimate` takes it.
    positive_text, negative_text : str
        What it is in words if its first number is positive, and if it is negative; ``{}`` is its amount.
    """

    id: str
    numbers: tuple[str, ...]
    sizes: tuple[float, ...]
    unit: str
    positive_text: str
    negative_text: str
    is_ramp: bool = False
    non_negative: bool = False

    def words(self, size: float, std: float) -> str:
        """Describe it in words, with the `size` of its first number and its standard error `std`."""
        return (self.negative_text if size < 0 else self.positive_text).format(
            format_estimate(abs(size), std, self.unit)
        )


def _all() -> tuple[Change, ...]:
    rotors = tuple(
        Change(
            f"thrust_step.{rotor}",
            (f"thrust_step_{rotor}_share",),
            (0.1,),
            "1",
            f"the {rotor} rotor lost {{}} of its thrust",
            f"the {rotor} rotor gained {{}} of its thrust",
        )
        for rotor in ("front", "back")
    )
    both = "thrust_step_front_share+thrust_step_back_share"
    frictions = tuple(
        Change(
            f"coulomb_friction.{axis}",
            (f"coulomb_friction_{axis}_Nm",),
            (2.0 * typical_Nm,),
            "N m",
            f"the {axis} axis has {{}} more dry friction",
            f"the {axis} axis has {{}} less dry friction",
            non_negative=True,
        )
        for axis, typical_Nm in zip(AXES, (0.03, 0.01, 0.02), strict=True)
    )
    zeros = tuple(
        Change(
            f"zero_offset.{axis}",
            (f"zero_offset_{axis}_rad",),
            (0.03,),
            "rad",
            f"the {axis} encoder shows {{}} too much",
            f"the {axis} encoder shows {{}} too little",
        )
        for axis in AXES
    )
    scales = tuple(
        Change(
            f"encoder_scale.{axis}",
            (number,),
            (0.5,),  # a decoder that counts one edge of two, or a disc with half the lines
            "1",
            f"the {axis} encoder counts {{}} more than its counts per turn",
            f"the {axis} encoder counts {{}} fewer than its counts per turn",
        )
        for number, axis in SCALES.items()
    )
    cables = tuple(
        Change(
            f"cable_spring.{axis}",
            (f"cable_spring_{axis}_Nm_per_rad", f"torque_{axis}"),
            (0.1, 0.03),
            "N m/rad",
            f"a cable pulls {axis} with {{}}",
            f"a cable pushes {axis} with {{}}",
        )
        for axis in ("elevation", "travel")
    )
    return (
        *rotors,
        Change(
            "thrust_fade",
            (both,),
            (0.01,),
            "1/s",
            "both rotors lose {} of their thrust",
            "both rotors gain {} of their thrust",
            is_ramp=True,
        ),
        Change(
            "supply_step",
            (SUPPLY,),
            (0.1,),
            "1",
            "the supply lost {} of its voltage",
            "the supply gained {} of its voltage",
        ),
        Change(
            "counterweight_shift",
            ("counterweight_shift_m",),
            (0.01,),
            "m",
            "the counterweight slipped by {} outwards",
            "the counterweight slipped by {} inwards",
        ),
        *frictions,
        *zeros,
        *scales,
        *cables,
    )


CHANGES: Final = _all()


def extended(model: Model) -> Model:
    """Add to a model what its numbers may change by, at values at which that does nothing."""
    kinds = catalogue()
    stated = {effect.name for effect in model.effects}
    wanted: dict[str, Effect] = {}
    for change in changes_of(model):
        if change.id in kinds and change.id not in stated:
            kind = kinds[change.id]
            values = {name: 0.0 for name in kind.neutral if name.endswith("_at_s")}
            wanted[change.id] = kind.make({**kind.neutral, **values})
    return type(model)((*model.effects, *wanted.values()))


def changes_of(model: Model) -> tuple[Change, ...]:
    """Changes that a rig with these equations may have."""
    kinds = catalogue()
    return tuple(change for change in CHANGES if change.id not in kinds or kinds[change.id].suits(model))


def free_numbers(changes: Sequence[Change]) -> tuple[str, ...]:
    """Parameters of the extended model by which the changes are derivatives."""
    every = (name for change in changes for entry in change.numbers for name in entry.split("+"))
    return tuple(dict.fromkeys(name for name in every if name != SUPPLY and name not in SCALES))
