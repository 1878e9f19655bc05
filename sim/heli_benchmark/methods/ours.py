"""The diagnosis of this project, `heli-host diagnose`, with its default settings."""

from __future__ import annotations

import math
from typing import Any, Final

from heli_lab.diagnose import diagnose as lab_diagnose
from heli_lab.diagnose import to_json
from heli_sim.model import MultibodyModel

from heli_benchmark.task import NOTHING, UNLISTED, BenchmarkCase, Estimate, answer_with

_EXPLAINED: Final = 0.95
"""Probability of nothing if the nominal model explains the flights: the share that
docs/validation/diagnosis.md requires of cases with nothing hidden."""
_UNEXPLAINED: Final = 0.7
"""Probability of an unlisted cause if the verdict is `unexplained`; set by judgement, not tuned."""
_OTHERWISE: Final = 0.05
_REFITS: Final = 80
"""Maximum number of refits, the default of the command line."""
_PARTS: Final = {"rotor_lag_with_delay": ("rotor_lag", "input_delay")}


def diagnose(case: BenchmarkCase) -> dict[str, Any]:
    """Diagnose a case with the laboratory."""
    labels = [f"flight {i}" for i in range(len(case.training) + len(case.validation))]
    found = lab_diagnose(
        MultibodyModel(), case.rig, case.training, case.validation, labels=labels, refits=_REFITS, threads=1
    )
    result = to_json(found)
    named: dict[str, float] = {UNLISTED: _UNEXPLAINED if result["verdict"] == "unexplained" else _OTHERWISE}
    parameters: dict[str, Estimate] = {}
    for name, of in (result["rig"] or {"numbers": {}})["numbers"].items():
        if name in case.rig and of["std"] and math.isfinite(of["std"]):
            parameters[name] = Estimate(float(of["value"]), float(of["std"]))
    for cause in result["causes"]:
        confidence, effect = float(cause["confidence"]), cause["effect"]
        for name in _PARTS.get(effect, (effect,)):
            if name in case.causes.listed:
                named[name] = max(named.get(name, 0.0), confidence)
            elif not name.startswith("random_torque"):
                named[UNLISTED] = max(named[UNLISTED], confidence)
        for other in cause["ambiguous_with"]:
            if other in case.causes.listed:
                named.setdefault(other, 1.0 - confidence)
        for name, of in cause["parameters"].items():
            if name in case.causes.parameter_names and of["std"] and math.isfinite(of["std"]):
                parameters[name] = Estimate(float(of["value"]), float(of["std"]))
    if result["verdict"] == "explained" and len(named) == 1:
        named = {NOTHING: _EXPLAINED}
    return answer_with(case.causes, named, parameters)
