"""What the verbs that fit begin with: rig, model and flights, read and checked."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from heli_lab.fit_options import DEFAULT_MODEL

if TYPE_CHECKING:
    from heli_host.flight import Flight
    from heli_sim.model.base import Model
    from heli_sim.rig import Rig


@dataclass(frozen=True)
class FitInputs:
    """Input of a fit.

    Parameters
    ----------
    rig : Rig
        Values and tolerances before the fit.
    model : Model
        Equations of motion, with the effects that the rig states and those that were asked for.
    labels : list of str
        Short names of the flights, those for validation last.
    """

    rig: Rig
    model: Model
    labels: list[str]


def fit_inputs(
    flights: Sequence[Path],
    validate: Sequence[Path],
    rig: str,
    model: str | None,
    effect_files: Sequence[Path],
    effects: Sequence[str] = (),
) -> FitInputs:
    """Read rig and model of a fit.

    Parameters
    ----------
    flights, validate : sequence of Path
        Files of the flights to fit and to validate on.
    rig : str
        Name or file of the rig.
    model : str or None
        Name of the model; None for the one that the rig names, or `DEFAULT_MODEL`.
    effect_files : sequence of Path
        Python files with further effects.
    effects : sequence of str
        Effects as the command line spells them; they come before those that the rig states.

    Raises
    ------
    SimError
        When rig, model or an effect is unknown or wrong.
    """
    from heli_sim.model.effects import effects_of, parse_effects
    from heli_sim.model.named import model_named
    from heli_sim.rig import load_rig

    from heli_lab.identify.result import short_names

    chosen = load_rig(rig)
    asked = parse_effects(effects, effect_files)
    names = {one.name for one in asked}
    stated = tuple(one for one in effects_of(chosen, effect_files) if one.name not in names)
    equations = model_named(model or chosen.model or DEFAULT_MODEL, stated + asked)
    return FitInputs(chosen, equations, short_names([*flights, *validate]))


def read_flights(paths: Sequence[Path], allow_gaps: bool = False) -> list[Flight]:
    """Read and check the flights of files, `paths`, in which rows may be missing if `allow_gaps`; a
    FlightDataError names file, column and row that cannot be used.
    """
    from heli_host.log.flight_file import read_flight

    return [read_flight(path, allow_gaps=allow_gaps) for path in paths]
