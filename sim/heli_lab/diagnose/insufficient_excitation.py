"""The result for flights without excitation: what cannot be known from them, and the experiment proposed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from heli_sim.model.base import Model
from heli_sim.model.effects import EffectKind
from heli_sim.rig import Rig

from heli_lab.diagnose.experiment_design import ExperimentDesign, compose_experiment
from heli_lab.identify.free import free_parameters

_LABEL: Final = "ambiguous"
"""Without excitation every effect, and none, is equally likely."""


@dataclass(frozen=True)
class InsufficientExcitation:
    """A diagnosis of flights in which nothing is excited.

    Parameters
    ----------
    why : str
        Why they are not, with the remedy.
    undetectable : tuple of str
        Effects that may be there or not: all that the model could have.
    unidentifiable : tuple of str
        Parameters of the rig that are not identified: all that are free.
    """

    why: str
    undetectable: tuple[str, ...]
    unidentifiable: tuple[str, ...]
    next_flight: ExperimentDesign

    @property
    def label(self) -> str:
        """The verdict."""
        return _LABEL


def insufficient_excitation(
    why: str, model: Model, rig: Rig, kinds: Mapping[str, EffectKind]
) -> InsufficientExcitation:
    """Make the result for flights without excitation; `why` is the message of `NotExcited`."""
    return InsufficientExcitation(
        why,
        tuple(sorted(id_ for id_, kind in kinds.items() if kind.suits(model))),
        tuple(parameter.quantity for parameter in free_parameters(model, rig, None, {})),
        compose_experiment("Of a rig that does not fly nothing can be learned.", ()),
    )
