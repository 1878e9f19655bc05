"""Result for flights without excitation: nothing can be said about them, and an experiment is proposed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from heli_sim.model.base import Model
from heli_sim.model.effects import EffectSpec
from heli_sim.rig import Rig

from heli_lab.explain.experiment.design import ExperimentDesign, compose_experiment
from heli_lab.fit.problem import free_parameters

_LABEL: Final = "ambiguous"
"""Without excitation all effects, and none, are equally likely."""


@dataclass(frozen=True)
class InsufficientExcitation:
    """Result of a diagnosis of flights that excite nothing.

    Parameters
    ----------
    why : str
        What is wrong with the flights, and how to fix it.
    undetectable : tuple of str
        Ids of all effects that the model may have.
    unidentifiable : tuple of str
        Names of all free parameters of the rig.
    next_flight : ExperimentDesign
        Proposed experiment.
    rig, model : str
        Names of the rig and of the equations.
    """

    why: str
    undetectable: tuple[str, ...]
    unidentifiable: tuple[str, ...]
    next_flight: ExperimentDesign
    rig: str
    model: str

    @property
    def label(self) -> str:
        """The verdict, ``ambiguous``."""
        return _LABEL


def insufficient_excitation(
    why: str, model: Model, rig: Rig, kinds: Mapping[str, EffectSpec]
) -> InsufficientExcitation:
    """Make the result for flights without excitation.

    Parameters
    ----------
    why : str
        Message of `NotExcited`.
    """
    return InsufficientExcitation(
        why,
        tuple(sorted(id_ for id_, kind in kinds.items() if kind.suits(model))),
        tuple(parameter.quantity for parameter in free_parameters(model, rig, None, {})),
        compose_experiment("A rig that does not fly shows nothing.", ()),
        rig.name,
        model.name,
    )
