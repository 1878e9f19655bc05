"""`python -m heli_benchmark.runs.calm [SEED...]`: which small effects are named without disturbances.

Without disturbances a flight shows effects far below an encoder count, and the numerical errors of the method
are as large. Seeds 7000 to 7029 are for development; 7100 to 7129 judge.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from typing import Any, Final

from heli_benchmark.cases.clean import Stream
from heli_benchmark.cases.disturbed import PAPER_RIG, DisturbedCase, RATES_Hz
from heli_benchmark.effects.listed import LISTED
from heli_benchmark.flights import CONTROLLERS
from heli_benchmark.runs.case import diagnosed_cases
from heli_benchmark.runs.shocks import UNDISTURBED

CALM_EFFECTS: Final = (
    (),
    (("supply_sag", 0.01),),
    (("supply_sag", 0.0025),),
    (("input_delay", 0.03), ("supply_sag", 0.008)),
)
"""Hidden effects with their sizes; a seed selects by its remainder. A sag is a share per volt of the
rotors' mean: twice the catalogue's share per volt of their sum."""


@dataclass(frozen=True)
class CalmCase(DisturbedCase):
    """Small effects in a rig of slightly different parameters."""


def calm_case(seed: int) -> CalmCase:
    """Draw the case of a `seed`."""
    rng = Stream.CALM_CASE.rng(seed)
    effects = CALM_EFFECTS[seed % len(CALM_EFFECTS)]
    return CalmCase(
        name=f"calm-{'+'.join(f'{id_}-{size:g}' for id_, size in effects) or 'nothing'}-{seed}",
        effects=effects,
        unlisted=(),
        seed=seed,
        makers=tuple(LISTED[id_].maker for id_, _ in effects),
        rig_name=PAPER_RIG,
        rate_Hz=RATES_Hz[int(rng.integers(len(RATES_Hz)))],
        gentle=False,
        controller=CONTROLLERS[int(rng.integers(len(CONTROLLERS)))],
        disturbances=UNDISTURBED,
    )


def false_names(case: CalmCase, result: dict[str, Any]) -> list[str]:
    """Return the causes of a `result` that are not hidden in the case."""
    hidden = {id_ for id_, _ in case.effects}
    return [cause["effect"] for cause in result["causes"] if cause["effect"] not in hidden]


def unreported(case: CalmCase, result: dict[str, Any]) -> list[str]:
    """Return the hidden effects that a `result` neither names nor reports as too small to matter."""
    reported = {entry["effect"] for key in ("causes", "too_small") for entry in result[key]}
    return [id_ for id_, _ in case.effects if id_ not in reported]


def main() -> None:
    """Diagnose the cases of all seeds and print one row per case."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("seeds", nargs="*", type=int, default=list(range(7000, 7004)))
    options = parser.parse_args()
    total = quiet = reported = 0
    for case, result, cpu_s in diagnosed_cases(map(calm_case, options.seeds)):
        wrong, missed = false_names(case, result), unreported(case, result)
        total, quiet, reported = total + 1, quiet + (not wrong), reported + (not missed)
        word = "WRONG" if wrong else "MISSED" if missed else "right"
        print(f"{case.name:45} {word:6} {result['verdict']:12} {cpu_s:5.1f} s", flush=True)
        for cause in result["causes"]:
            state = "confirmed" if cause.get("confirmed") else "not confirmed"
            print(f"    {cause['effect']} ({cause['confidence']:.2f}, {state}): {cause['sentence']}")
        for small in result["too_small"]:
            print(f"    too small, {small['change_counts']:.3f} counts: {small['sentence']}")
    print(f"no false name: {quiet} of {total}; every hidden effect named or reported: {reported} of {total}")


if __name__ == "__main__":
    main()
