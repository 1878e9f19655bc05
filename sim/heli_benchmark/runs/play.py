"""`python -m heli_benchmark.runs.play [SEED...]`: names and sizes of plays."""

from __future__ import annotations

import argparse
import math

from heli_benchmark.cases.play import play_case
from heli_benchmark.runs.ask import diagnosed_cases


def main() -> None:
    """Diagnose the cases of all seeds, and print one row per case and one for all."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("seeds", nargs="*", type=int, default=list(range(9000, 9009)))
    options = parser.parse_args()
    named = within = cases = unexplained = false_names = 0
    for case, result, spent_s in diagnosed_cases(map(play_case, options.seeds)):
        ((effect, truth_deg),) = case.effects
        causes = {cause["effect"]: cause for cause in result["causes"]}
        cases, false_names = cases + 1, false_names + len(causes.keys() - {effect})
        size = "not named"
        if effect in causes:
            number = causes[effect]["parameters"][f"{effect.replace('.', '_')}_rad"]
            value_deg, std_deg = math.degrees(number["value"]), math.degrees(number["std"])
            named, within = named + 1, within + (abs(value_deg - truth_deg) < 2.0 * std_deg)
            unexplained += result["verdict"] == "unexplained"
            size = f"{value_deg:.3f} ± {std_deg:.3f} deg, truth {truth_deg:.3f}"
        print(
            f"{case.name:36} {result['verdict']:12} {spent_s:5.1f} s  {size}; {', '.join(causes)}", flush=True
        )
    print(
        f"named {named} of {cases}, sizes within two standard errors {within} of {named}, "
        f"named but unexplained {unexplained}, false names {false_names}"
    )


if __name__ == "__main__":
    main()
