"""`python -m heli_benchmark.runs.play [SEED...]`: names and sizes of plays.

Three axes, three sizes, three strengths of disturbances. Seeds 9000 to 9099 are for development; 9100 to 9199
judge. Nine consecutive seeds, the first a multiple of nine, have each axis with each size once, and each
strength three times.
"""

from __future__ import annotations

import argparse
import math
from dataclasses import dataclass
from typing import Final

from heli_benchmark.cases.clean import Stream
from heli_benchmark.cases.disturbed import MAKERS, PAPER_RIG, DisturbedCase, RATES_Hz
from heli_benchmark.effects.disturbances import CORRELATION_TIMES_s, DisturbanceModel, STRENGTHS_Nm
from heli_benchmark.flights import CONTROLLERS
from heli_benchmark.runs.case import diagnosed_cases
from heli_benchmark.runs.shocks import UNDISTURBED

PLAY_AXES: Final = ("elevation", "pitch", "travel")
PLAYS_deg: Final = (0.5, 1.5, 3.0)
_GUSTS_Nm: Final = (UNDISTURBED.gusts_Nm, STRENGTHS_Nm[1], STRENGTHS_Nm[2])
_STRENGTH_NAMES: Final = ("no", "moderate", "strong")


@dataclass(frozen=True)
class PlayCase(DisturbedCase):
    """A play of one encoder."""


def play_case(seed: int) -> PlayCase:
    """Draw the case of a `seed`, which counts through axes, then sizes; the strength is a Latin square."""
    rng = Stream.PLAY_CASE.rng(seed)
    axis_index, size_index = seed % 3, seed // 3 % 3
    strength_index = (axis_index + size_index + seed // 9) % 3
    axis, play_deg, strength = PLAY_AXES[axis_index], PLAYS_deg[size_index], _STRENGTH_NAMES[strength_index]
    effect = f"backlash.{axis}"
    return PlayCase(
        name=f"play-{axis}-{play_deg:g}-{strength}-{seed}",
        effects=((effect, play_deg * float(rng.uniform(0.85, 1.15))),),
        unlisted=(),
        seed=seed,
        makers=(MAKERS[effect],),
        rig_name=PAPER_RIG,
        rate_Hz=RATES_Hz[int(rng.integers(len(RATES_Hz)))],
        gentle=False,
        controller=CONTROLLERS[int(rng.integers(len(CONTROLLERS)))],
        disturbances=DisturbanceModel(_GUSTS_Nm[strength_index], CORRELATION_TIMES_s[int(rng.integers(3))]),
    )


def main() -> None:
    """Diagnose the cases of all seeds, and print one row per case and one for all."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("seeds", nargs="*", type=int, default=list(range(9000, 9009)))
    options = parser.parse_args()
    named = within = cases = unexplained = false_names = 0
    for case, result, cpu_s in diagnosed_cases(map(play_case, options.seeds)):
        ((effect, truth_deg),) = case.effects
        causes = {cause["effect"]: cause for cause in result["causes"]}
        cases += 1
        false_names += len(causes.keys() - {effect})
        size = "not named"
        if effect in causes:
            number = causes[effect]["parameters"][f"{effect.replace('.', '_')}_rad"]
            value_deg, std_deg = math.degrees(number["value"]), math.degrees(number["std"])
            named += 1
            within += abs(value_deg - truth_deg) < 2.0 * std_deg
            unexplained += result["verdict"] == "unexplained"
            size = f"{value_deg:.3f} ± {std_deg:.3f} deg, truth {truth_deg:.3f}"
        print(
            f"{case.name:36} {result['verdict']:12} {cpu_s:5.1f} s  {size}; {', '.join(causes)}", flush=True
        )
    print(
        f"named {named} of {cases}, sizes within two standard errors {within} of {named}, "
        f"named but unexplained {unexplained}, false names {false_names}"
    )


if __name__ == "__main__":
    main()
