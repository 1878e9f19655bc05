"""The diagnosis of this project, `heli-host diagnose`, with its default settings."""

from __future__ import annotations

import math
from typing import Any, Final

from heli_lab.diagnose import Diagnosis, to_json
from heli_lab.diagnose import diagnose as lab_diagnose
from heli_sim.model import MultibodyModel
from heli_sim.rig import Rig

from heli_benchmark.task import NOTHING, UNLISTED, BenchmarkCase, Causes, Estimate, answer_with, of_parts

_LISTED: Final = "listed"
_SHARES: Final = {
    "explained": {NOTHING: 42 / 44, _LISTED: 2 / 50, UNLISTED: 2 / 23},
    "unexplained": {NOTHING: 2 / 44, _LISTED: 2 / 50, UNLISTED: 21 / 23},
    "cause_found": {NOTHING: 2 / 44, _LISTED: 48 / 50, UNLISTED: 2 / 23},
}
"""Share of each verdict by what is hidden: counts of the disturbed cases in docs/validation/diagnosis.md, by
the rule of succession."""
_REFITS: Final = 80
"""Maximum number of refits, the default of the command line."""


def diagnose(case: BenchmarkCase) -> dict[str, Any]:
    """Diagnose a case by `heli_lab.explain`, and translate its verdict and causes to probabilities."""
    labels = [f"flight {i}" for i in range(len(case.training) + len(case.validation))]
    diagnosis = lab_diagnose(
        MultibodyModel(), case.rig, case.training, case.validation, labels=labels, refits=_REFITS, threads=1
    )
    result = to_json(diagnosis)
    causes = [cause for cause in result["causes"] if not cause["effect"].startswith("random_torque")]
    verdict = result["verdict"]
    if verdict in ("cause_found", "ambiguous"):
        # Disturbances alone are no hidden cause.
        verdict = "cause_found" if causes else "explained"
    named: dict[str, float] = {UNLISTED: probability(UNLISTED, verdict, case.causes)}
    parameters = _rig_parameters(diagnosis, causes, case.rig)
    for cause in causes:
        confidence, effect = float(cause["confidence"]), cause["effect"]
        estimates_by_cause = of_parts(effect, cause["parameters"])
        for name in estimates_by_cause:
            if name in case.causes.listed:
                named[name] = max(named.get(name, 0.0), confidence)
            else:
                named[UNLISTED] = max(named[UNLISTED], confidence)
        for other in cause["ambiguous_with"]:
            if other in case.causes.listed:
                # The doubt is also about what no effect explains: no alternative is more probable than the
                # cause.
                named.setdefault(other, min(confidence, 1.0 - confidence))
        for name, estimate in (item for part in estimates_by_cause.values() for item in part.items()):
            has_error = estimate["std"] and math.isfinite(estimate["std"])
            if name in case.causes.parameter_names and has_error:
                parameters[name] = Estimate(float(estimate["value"]), float(estimate["std"]))
    if verdict == "explained" and len(named) == 1:  # no cause in addition to UNLISTED
        named = {NOTHING: probability(NOTHING, "explained", case.causes)}
    elif not causes and verdict != "unexplained":
        # The flights excite too little: the base rates stay.
        named = {}
    return answer_with(case.causes, named, parameters)


def _rig_parameters(diagnosis: Diagnosis, causes: list[dict[str, Any]], nominal: Rig) -> dict[str, Estimate]:
    """Return the rig parameters that the diagnosis changed, fitted together with all named causes."""
    # A fit without a cause would imitate it with parameters of the rig. Unlike the parameters in the JSON,
    # these also include the constant torques and encoder zeros.
    with_unconfirmed = any(c["confidence"] >= 0.5 and not c.get("confirmed", True) for c in causes)
    rig = diagnosis.rig("extended", with_unconfirmed=with_unconfirmed)
    return {
        name: Estimate(number.value, 0.5 * number.tolerance)
        for name, number in rig.numbers.items()
        if number != nominal[name] and number.tolerance > 0.0
    }


def probability(hidden: str, verdict: str, causes: Causes) -> float:
    """Return the probability of `nothing` or of `unlisted` after a verdict, by Bayes' rule."""
    rates = {name: causes.base_rates[name] for name in (NOTHING, UNLISTED)}
    rates[_LISTED] = 1.0 - sum(rates.values())
    shares = _SHARES.get(verdict, dict.fromkeys(rates, 1.0))
    return rates[hidden] * shares[hidden] / sum(rate * shares[name] for name, rate in rates.items())
