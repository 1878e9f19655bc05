"""What the verbs that fit begin with: rig, model and flights, read and checked."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from heli_lab.errors import IdentifyError, NotExcited, WrongSigns
from heli_lab.fit_options import DEFAULT_MODEL

if TYPE_CHECKING:
    from heli_host.flight import Flight
    from heli_sim.model.base import Model
    from heli_sim.rig import Rig

    from heli_lab.identify.record import Record


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
    given_effects = parse_effects(effects, effect_files)
    names = {effect.name for effect in given_effects}
    stated = tuple(effect for effect in effects_of(chosen, effect_files) if effect.name not in names)
    equations = model_named(model or chosen.model or DEFAULT_MODEL, stated + given_effects)
    return FitInputs(chosen, equations, short_names([*flights, *validate]))


def parts(
    from_s: Sequence[float], to_s: Sequence[float], fitted: int, validated: int
) -> list[tuple[float | None, float | None]]:
    """Give each flight its part.

    Parameters
    ----------
    from_s, to_s : sequence of float
        None, one for all flights to fit, one for each of these, or one for each and for those to validate.
    fitted, validated : int
        Numbers of flights.

    Returns
    -------
    list of (float or None, float or None)
        First time and first time no longer used of each flight, those to fit first.

    Raises
    ------
    IdentifyError
        When there are more or fewer times than that.
    """
    ends = []
    for option, times in (("--from", from_s), ("--to", to_s)):
        if len(times) > 1 and len(times) not in (fitted, fitted + validated):
            raise IdentifyError(
                f"{option} has {len(times)} times for {fitted} flights to fit and {validated} to validate",
                "give one for all, or one for each",
            )
        whole: list[float | None] = list(times) if len(times) != 1 else [*times] * fitted
        ends.append(whole + [None] * (fitted + validated - len(whole)))
    return list(zip(*ends, strict=True))


def part_of(flight: Flight, rig: Rig, label: str, part: tuple[float | None, float | None]) -> Flight | Record:
    """Prepare a `flight`, whose messages call it `label`, of which only a `part` is used; a flight that is
    used whole is returned as it is.
    """
    from heli_lab.identify.record import prepare

    if part == (None, None):
        return flight
    return prepare(flight, rig, label, start_s=part[0], stop_s=part[1])


def refuse_wrong_signs(flights: Sequence[Flight], labels: Sequence[str], rig: Rig) -> None:
    """Refuse flights, called `labels`, whose signs, zeros or units are not those of a flight; a WrongSigns
    says what is wrong with the first, and the remedy.
    """
    from heli_lab.guess.signs import wrong_signs
    from heli_lab.identify.record import prepare

    for flight, label in zip(flights, labels, strict=True):
        try:
            prepare(flight, rig, label)
        except NotExcited:
            # An elevation that counts the other way is below its table all the time.
            pass
        except IdentifyError:
            # What is not sound has no signs; the fit says what is wrong with it.
            continue
        wrong = wrong_signs(flight, rig)
        if wrong:
            raise WrongSigns(
                f"{label}: {'; '.join(sign.description for sign in wrong)}",
                f"{'; '.join(sign.remedy for sign in wrong)} (or fit it --as-is)",
            )


def read_flights(paths: Sequence[Path], allow_gaps: bool = False) -> list[Flight]:
    """Read and check the flights of files, `paths`, in which rows may be missing if `allow_gaps`; a
    FlightDataError names file, column and row that cannot be used.
    """
    from heli_host.log.flight_file import read_flight

    # Of ten minutes at 1 kHz the columns that no fit looks at are 80 MB.
    return [replace(read_flight(path, allow_gaps=allow_gaps), extra={}) for path in paths]
