"""What a law takes of the error that a listed effect takes which is off the list; and whether it flies."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from heli_host.flight import Flight
from heli_lab.campaign.works import DEFAULTS, fly
from heli_lab.diagnose.search import ModelComparison
from heli_lab.identify import prepare
from heli_sim.model import MultibodyModel
from heli_sim.rig import load_rig

from tests.blind.disturbed_case import DisturbedCase
from tests.blind.equation_oracle import listed, told_errors_deg
from tests.blind.run import REFITS, found_in
from tests.blind.taken_off import TAKEN_OFF


def judged_in_place(
    case: DisturbedCase, flights: tuple[Flight, Flight], folder: Path, refits: int = REFITS
) -> dict[str, Any]:
    """Diagnose a case without its last effect on the list, and hold the law in its place against the effect.

    Parameters
    ----------
    case : DisturbedCase
        The case.
    flights : tuple of Flight
        The flight to fit and the one to hold out.
    folder : Path
        Where the law's effect file goes.
    refits : int
        Most refits of the search.

    Returns
    -------
    dict
        ``verdict``, ``causes``, ``expression`` of the law (None where none is proposed); ``axis``, about
        which the effect takes most; errors there over 2 s of the flight held out, in degrees, of a fit told
        all but the effect (``without_deg``), told all (``told_deg``), with what the diagnosis found
        (``found_deg``); ``share``, of what the effect takes, that the law takes; ``flies``, how a flight with
        the law ended.
    """
    rig = load_rig(case.rig_name)
    name = case.effects[-1][0]
    found = found_in(rig, flights, refits, (name, *TAKEN_OFF[name]))
    proposed = found.proposed_term
    records = [prepare(flight, rig, label) for flight, label in zip(flights, "ab", strict=True)]
    comparison = ModelComparison(MultibodyModel(), rig, records[:1], records[1:])
    rest = listed(one for one, _ in case.effects[:-1])
    without, told = (told_errors_deg(comparison, [*rest, *more]) for more in ([], listed([name])))
    axis = max(told, key=lambda one: without[one] / told[one])
    proposal = found.proposal
    gains = found.error_reductions if proposal is None else proposal.evaluation.reductions
    answer: dict[str, Any] = {
        "verdict": found.label,
        "causes": [one.candidate.id for one in found.verdict.causes],
        "expression": None if proposed is None else proposed.sentence,
        "axis": axis,
        "without_deg": without[axis],
        "told_deg": told[axis],
        "found_deg": gains[axis].after_deg,
        "share": (without[axis] - gains[axis].after_deg) / (without[axis] - told[axis]),
        "seconds": found.effort.seconds,
    }
    if proposed is not None:
        path = folder / case.name / "proposed.py"
        path.write_text(proposed.effect_file("Proposed."))
        effect = proposed.discovery.effect.name
        flown, _ = fly({**DEFAULTS, "plan": "hover", "effect_files": [str(path)], "effects": [effect]})
        answer["flies"] = flown["outcome"]
    return answer
