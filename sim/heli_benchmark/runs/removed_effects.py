"""`python -m heli_benchmark.runs.removed_effects`: does a discovered equation replace a removed effect?"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from heli_host.data.flight import Flight
from heli_lab.apps.campaign.works import DEFAULTS, fly
from heli_lab.explain.comparison import ModelComparison
from heli_lab.fit.records import prepare
from heli_sim.model import MultibodyModel
from heli_sim.rig import load_rig

from heli_benchmark.cases.clean import chosen
from heli_benchmark.cases.disturbed import LAG, PAPER_RIG, SIZES, DisturbedCase
from heli_benchmark.effects.disturbances import CORRELATION_TIMES_s, DisturbanceModel, STRENGTHS_Nm
from heli_benchmark.effects.listed import LISTED, MEASURED_EFFECTS, MORE_LISTED, Maker
from heli_benchmark.flights import CONTROLLERS
from heli_benchmark.runs.case import REFITS, run_diagnosis
from heli_benchmark.runs.equations import (
    EquationRow,
    add_rows,
    informed_errors_deg,
    judge_rows,
    listed_candidates,
)

REMOVED: Final[Mapping[str, tuple[str, ...]]] = {
    LAG: ("rotor_speed_lag", "rotor_lag_with_delay", "input_delay"),
    "travel_drag_quadratic": (),
    "pitch_drag_quadratic": (),
    "cable_spring.travel": (),
    "axis_tilt": (),
    "edgewise_flow": (),
    "gyroscopic_torque": ("flywheel",),
    "rotor_reaction_torque": (),
    "coulomb_friction.travel": (),
    "thrust_asymmetry": (),
    "inflow_damping": (),
    "encoder_eccentricity.travel": (),
}
"""Effects, each with those of its family: another name for the same effect would leave no gap."""
_LAG_s, _LARGER = 0.1, 1.6
"""Lag in s, and factor of the other sizes under weak disturbances: each effect must reduce an error that is
visible above the disturbances."""
_MAKERS: Final[Mapping[str, Maker]] = {
    **{name: maker for name, (maker, _, _) in (LISTED | MORE_LISTED).items()},
    **{name: maker for name, (maker, _) in MEASURED_EFFECTS.items()},
}


def removed_effect_cases() -> list[DisturbedCase]:
    """Return one case of each effect."""
    cases = []
    for number, name in enumerate(REMOVED):
        lag_effect = ((LAG, _LAG_s),) if number % 2 and name != LAG else ()
        effects = (*lag_effect, (name, SIZES[name] * (1.0 if name == LAG else _LARGER)))
        cases.append(
            DisturbedCase(
                f"taken-off-{name}",
                effects,
                unlisted=(),
                seed=6000 + number,
                makers=tuple(_MAKERS[effect] for effect, _ in effects),
                rig_name=PAPER_RIG,
                rate_Hz=100,
                gentle=False,
                controller=CONTROLLERS[number % 3],
                disturbances=DisturbanceModel(STRENGTHS_Nm[0], CORRELATION_TIMES_s[number % 3]),
            )
        )
    return cases


def judge_replacement(
    case: DisturbedCase, flights: tuple[Flight, Flight], folder: Path, refits: int = REFITS
) -> dict[str, Any]:
    """Diagnose a case without its last effect in the catalogue, and judge the equation that replaces it."""
    rig = load_rig(case.rig_name)
    *others, (removed, _) = case.effects
    diagnosis = run_diagnosis(rig, flights, refits, (removed, *REMOVED[removed]))
    proposed = diagnosis.proposed_term
    training, held_out = (prepare(flight, rig, label) for flight, label in zip(flights, "ab", strict=True))
    comparison = ModelComparison(MultibodyModel(), rig, [training], [held_out])
    other_causes = listed_candidates(effect for effect, _ in others)
    errors_without_deg = informed_errors_deg(comparison, other_causes)
    informed_deg = informed_errors_deg(comparison, [*other_causes, *listed_candidates([removed])])
    # The axis on which the removed effect changes most.
    axis = max(informed_deg, key=lambda axis: errors_without_deg[axis] / informed_deg[axis])
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
    if proposed is not None:  # the equation must also work as an effect file in a simulated flight
        path = folder / case.name / "proposed.py"
        path.write_text(proposed.effect_file("Proposed."))
        effect = proposed.discovery.effect.name
        flown, _ = fly({**DEFAULTS, "plan": "hover", "effect_files": [str(path)], "effects": [effect]})
        answer["flies"] = flown["outcome"]
    return answer


SHARE = 0.8
"""Share of the error reduction of the removed effect that its equation must reach."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the cases and count."""
    parser = argparse.ArgumentParser(
        prog="python -m heli_benchmark.runs.removed_effects", description=__doc__
    )
    add_rows(parser, Path("removed_effects.json"))
    options = parser.parse_args(arguments)
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

    cases = chosen(removed_effect_cases(), options)
    rows = judge_rows(
        cases, lambda case, flights: judge_replacement(case, flights, options.folder), _describe_row, options
    )
    print(removed_effect_summary(rows))
    return 0 if all("failure" not in row for row in rows.values()) else 1


def _describe_row(row: EquationRow) -> str:
    """Return one line: visibility of the effect, verdict, equation, and errors of three fits."""
    if "failure" in row:
        return str(row["failure"])
    visibility_std = list(row["visibility"].values())[-1]
    return (
        f"[{visibility_std:.0f}] {row['verdict']}, {', '.join(row['causes']) or 'no cause'}: "
        f"{row['expression'] or 'no equation'}; {row['axis']} off by {row['without_deg']:.3g} deg without, "
        f"{row['found_deg']:.3g} with it, {row['informed_deg']:.3g} with the effect: share {row['share']:.2f}"
        f"{'; flown: ' + row['flies'] if 'flies' in row else ''}"
    )


def removed_effect_summary(rows: Mapping[str, EquationRow]) -> str:
    """Count equations that fly and explain `SHARE` of the error; `rows` are by case, as in the file."""
    completed = [row for row in rows.values() if "failure" not in row]
    proposed = [row for row in completed if row["expression"]]
    flying = [row for row in proposed if row["flies"] == "completed"]
    explaining = [row for row in flying if row["share"] >= SHARE]
    return (
        f"effects removed: {len(completed)}, equations proposed {len(proposed)}, flown {len(flying)}, "
        f"explain {SHARE:.0%} of the error of the effect {len(explaining)}"
    )


if __name__ == "__main__":
    sys.exit(main())
