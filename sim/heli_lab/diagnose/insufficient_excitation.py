"""The answer to flights in which nothing flew: what cannot be known, and which flight would tell."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

from heli_sim.model.base import Model
from heli_sim.model.effects import EffectKind
from heli_sim.model.parts import AXES
from heli_sim.rig import Rig

from heli_lab.diagnose.experiment_design import ExperimentDesign, next_flight
from heli_lab.identify.free import free_parameters

_WORD: Final = "ambiguous"
"""Without a flight that could tell, nothing missing and every effect do equally well."""


@dataclass(frozen=True)
class InsufficientExcitation:
    """A diagnosis of flights that show nothing.

    Parameters
    ----------
    why : str
        Why they show nothing, with its remedy.
    unseen : tuple of str
        Effects of which nothing is known: all that the model could have.
    unlearned : tuple of str
        Numbers of the rig of which nothing was learned: all that are open.
    next_flight : ExperimentDesign
        The flight that would tell.
    """

    why: str
    unseen: tuple[str, ...]
    unlearned: tuple[str, ...]
    next_flight: ExperimentDesign

    @property
    def word(self) -> str:
        """The verdict."""
        return _WORD

    @property
    def summary(self) -> str:
        """What can be said, in a sentence."""
        return f"Nothing can be said of what the model lacks: {self.why}."

    @property
    def lines(self) -> list[str]:
        """What cannot be known, and the flight that would tell."""
        return [
            f"not to be known from this: {', '.join(self.unseen)}",
            f"nor these numbers: {', '.join(self.unlearned)}",
            f"next flight: {self.next_flight.why}",
        ]

    def json(self) -> dict[str, Any]:
        """Spell the answer for other programs, keys as of a diagnosis, null for what is unknown.

        Returns
        -------
        dict
            verdict, causes, residual, gain, unexplained, next_flight and more.
        """
        unknown = {"before": None, "after": None}
        return {
            "verdict": self.word,
            "causes": [],
            "residual": {"axis": dict.fromkeys(AXES, unknown), "normalised": unknown, "white": {}},
            "gain": {
                "metric": "2 s free-run rms on the validation flights, deg",
                "axis": {axis: {**unknown, "ratio": None, "interval95": None} for axis in AXES},
            },
            "unexplained": None,
            "next_flight": {"why": self.next_flight.why, "plan": self.next_flight.plan},
            "why": self.why,
            "could_not_be_seen": list(self.unseen),
            "could_not_be_learned": list(self.unlearned),
            "cautions": [],
            "flights": [],
            "ranking": [],
            "complete": True,
        }


def insufficient_excitation(
    why: str, model: Model, rig: Rig, kinds: Mapping[str, EffectKind]
) -> InsufficientExcitation:
    """Answer flights that show nothing.

    Parameters
    ----------
    why : str
        What `NotExcited` said of them.
    model : Model
        The model.
    rig : Rig
        The rig.
    kinds : Mapping[str, EffectKind]
        The catalogue.

    Returns
    -------
    InsufficientExcitation
        The answer.
    """
    open_numbers = tuple(one.quantity for one in free_parameters(model, rig, None, {}))
    return InsufficientExcitation(
        why,
        tuple(sorted(id_ for id_, kind in kinds.items() if kind.suits(model))),
        open_numbers,
        next_flight("Of a rig that does not fly nothing can be learned.", ()),
    )
