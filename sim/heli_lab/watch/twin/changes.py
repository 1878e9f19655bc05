"""Possible changes of a rig in flight: each one changes one or two parameters of the model.

Effects of the catalogue describe themselves as changes (`heli_sim.model.effects.ChangeSpec`). This file lists
only changes that are no effect of the catalogue.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from heli_sim.model.base import Effect, Model
from heli_sim.model.effects import catalogue
from heli_sim.model.effects.spec import format_estimate
from heli_sim.model.parts import AXES

SUPPLY: Final = "supply"
"""Parameter of a change that is no parameter of the model: a share of both motor voltages."""
SCALES: Final = {f"encoder_scale_{axis}": axis for axis in AXES}
"""Parameters of changes that are no parameters of the model: a share of the counts per turn of an encoder,
with the axis of each. From the onset on, the encoder adds that share of each turn; its angle does not jump
at the onset."""


@dataclass(frozen=True)
class Change:
    """A hypothesis: from an unknown onset on, one or two rig parameters are different."""

    id: str  # Id of the effect of the catalogue, or another unique name
    parameters: tuple[str, ...]
    """One or two parameters of the extended model that the change adds to, or `SUPPLY`, or one of `SCALES`.
    Parameters joined by ``+`` change by the same amount."""
    sizes: tuple[float, ...]
    """Prior standard deviation of the change of each parameter, SI. A wider prior costs evidence (Occam's
    razor)."""
    unit: str  # Unit of the first parameter
    positive_text: str
    """positive_text, negative_text: Sentence if the first parameter grows or falls; ``{}`` is the amount."""
    negative_text: str
    is_ramp: bool = False  # True if the change grows from its onset at a constant rate; False for a step
    non_negative: bool = False  # True if the first parameter cannot fall

    @property
    def is_scale(self) -> bool:
        """Whether it is a wrong scale of an encoder."""
        return self.parameters[0] in SCALES

    @property
    def is_jump(self) -> bool:
        """Whether it is a jump of an encoder's zero."""
        return self.id.startswith("zero_offset.")

    def words(self, size: float, std: float) -> str:
        """Describe the change by the estimate `size` of its first parameter and the standard error `std`."""
        return (self.negative_text if size < 0 else self.positive_text).format(
            format_estimate(abs(size), std, self.unit)
        )


def _catalogue_changes() -> tuple[Change, ...]:
    """Return the changes that the effects of the catalogue describe."""
    return tuple(
        Change(
            spec.id,
            parameters=spec.change.numbers or (spec.full(spec.numbers[0].name),),
            sizes=spec.change.sizes,
            unit=spec.numbers[0].unit,
            positive_text=spec.change.positive,
            negative_text=spec.change.negative,
            is_ramp=spec.change.is_ramp,
            non_negative=spec.is_one_sided,
        )
        for spec in catalogue().values()
        if spec.change is not None
    )


_SUPPLY_STEP: Final = Change(
    "supply_step",
    (SUPPLY,),
    (0.1,),
    "1",
    "the supply lost {} of its voltage",
    "the supply gained {} of its voltage",
)
_ENCODER_SCALES: Final = tuple(
    Change(
        f"encoder_scale.{axis}",
        (parameter,),
        (0.5,),  # a decoder that counts one edge of two, or a disc with half the lines
        "1",
        f"the {axis} encoder counts {{}} more than its counts per turn",
        f"the {axis} encoder counts {{}} fewer than its counts per turn",
    )
    for parameter, axis in SCALES.items()
)


def all_changes() -> tuple[Change, ...]:
    """Return the changes that effects of the catalogue describe, then those that are no effect."""
    return (*_catalogue_changes(), _SUPPLY_STEP, *_ENCODER_SCALES)


def extended(model: Model) -> Model:
    """Add the effects of all possible changes to a model, at values at which they do nothing.

    The derivatives by their parameters are then derivatives by the changes. The effects act from 0 s on. The
    filter itself sets the derivatives to zero before an onset.
    """
    specs = catalogue()
    present_names = {effect.name for effect in model.effects}
    effects: dict[str, Effect] = {}
    for change in changes_of(model):
        if change.id in specs and change.id not in present_names:
            spec = specs[change.id]
            onsets_s = {name: 0.0 for name in spec.neutral if name.endswith("_at_s")}
            effects[change.id] = spec.make({**spec.neutral, **onsets_s})
    return type(model)((*model.effects, *effects.values()))


def changes_of(model: Model) -> tuple[Change, ...]:
    """Return the possible changes of a rig with these equations."""
    specs = catalogue()

    def is_possible(change: Change) -> bool:
        return change.id not in specs or specs[change.id].suits(model)

    return tuple(filter(is_possible, all_changes()))


def model_parameters(changes: Sequence[Change]) -> tuple[str, ...]:
    """Return the parameters of the extended model that the changes add to, each once."""
    names = (name for change in changes for entry in change.parameters for name in entry.split("+"))
    return tuple(dict.fromkeys(name for name in names if name != SUPPLY and name not in SCALES))
