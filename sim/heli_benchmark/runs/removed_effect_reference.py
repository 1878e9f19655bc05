"""Judge the equation that a diagnosis proposes for an effect that its catalogue lacks."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from heli_host.data.flight import Flight
from heli_lab.apps.campaign.works import DEFAULTS, fly
from heli_lab.explain.comparison import ModelComparison
from heli_lab.fit.records import prepare
from heli_sim.model import MultibodyModel
from heli_sim.rig import load_rig

from heli_benchmark.cases.disturbed_case import DisturbedCase
from heli_benchmark.cases.removed_effects import REMOVED
from heli_benchmark.runs.ask import REFITS, run_diagnosis
from heli_benchmark.runs.equation_reference import informed_errors_deg, listed_candidates


def judge_replacement(
    case: DisturbedCase, flights: tuple[Flight, Flight], folder: Path, refits: int = REFITS
) -> dict[str, Any]:
    """Diagnose a case without its last effect in the catalogue, and judge the equation that replaces it."""
    rig = load_rig(case.rig_name)
    name = case.effects[-1][0]
    diagnosis = run_diagnosis(rig, flights, refits, (name, *REMOVED[name]))
    proposed = diagnosis.proposed_term
    records = [prepare(flight, rig, label) for flight, label in zip(flights, "ab", strict=True)]
    comparison = ModelComparison(MultibodyModel(), rig, records[:1], records[1:])
    other_causes = listed_candidates(effect for effect, _ in case.effects[:-1])
    errors_without_deg = informed_errors_deg(comparison, other_causes)
    informed_deg = informed_errors_deg(comparison, [*other_causes, *listed_candidates([name])])
    axis = max(informed_deg, key=lambda name: errors_without_deg[name] / informed_deg[name])
    proposal = diagnosis.proposal
    reductions = diagnosis.error_reductions if proposal is None else proposal.evaluation.reductions
    found_deg = reductions[axis].after_deg
    answer: dict[str, Any] = {
        "verdict": diagnosis.label,
        "causes": [cause.candidate.id for cause in diagnosis.verdict.causes],
        "expression": None if proposed is None else proposed.sentence,
        "axis": axis,
        "without_deg": errors_without_deg[axis],
        "informed_deg": informed_deg[axis],
        "found_deg": found_deg,
        "share": (errors_without_deg[axis] - found_deg) / (errors_without_deg[axis] - informed_deg[axis]),
        "seconds": diagnosis.effort.seconds,
    }
    if proposed is not None:
        path = folder / case.name / "proposed.py"
        path.write_text(proposed.effect_file("Proposed."))
        effect = proposed.discovery.effect.name
        flown, _ = fly({**DEFAULTS, "plan": "hover", "effect_files": [str(path)], "effects": [effect]})
        answer["flies"] = flown["outcome"]
    return answer
