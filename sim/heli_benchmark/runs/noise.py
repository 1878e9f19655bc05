"""`python -m heli_benchmark.runs.noise [SEED...]`: verdicts under five kinds of noise.

Seeds 8000 to 8099 are for development; 8100 to 8199 judge. Twenty consecutive seeds have each kind twice with
nothing hidden, once with one cause and once with two.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

from typing_extensions import override

from heli_benchmark.cases.clean import Stream
from heli_benchmark.cases.disturbed import LAG, MAKERS, PAPER_RIG, SIZES, DisturbedCase, RATES_Hz
from heli_benchmark.effects.disturbances import NOISE
from heli_benchmark.flights import CONTROLLERS
from heli_benchmark.plant import HiddenEffect
from heli_benchmark.runs.case import diagnosed_cases
from heli_benchmark.runs.shocks import UNDISTURBED

NOISE_KINDS: Final = tuple(NOISE)
_ALONE: Final = (LAG, "thrust_asymmetry", "coulomb_friction.travel", "cable_spring.travel", "axis_tilt")
_WITH_LAG: Final = ("coulomb_friction.elevation", "thrust_asymmetry", "cable_spring.travel", "axis_tilt")
"""Causes that are plain under moderate disturbances."""


@dataclass(frozen=True)
class NoiseCase(DisturbedCase):
    """Causes, or none, under noise of one kind."""

    kind: str = ""  # Kind of noise, of `NOISE_KINDS`

    @override
    def hidden(self, flight: int = 0) -> list[HiddenEffect]:
        return [*super().hidden(flight), *NOISE[self.kind](Stream.NOISE.rng(self.seed, flight))]


def noise_case(seed: int) -> NoiseCase:
    """Draw the case of a `seed`."""
    rng = Stream.NOISE_CASE.rng(seed)
    # The seeds count through the kinds, then through the causes: none twice, one cause, two causes.
    kind = NOISE_KINDS[seed % len(NOISE_KINDS)]
    cause_count = max(0, seed // len(NOISE_KINDS) % 4 - 1)
    names: tuple[str, ...] = ()
    if cause_count == 1:
        names = (str(rng.choice(_ALONE)),)
    elif cause_count == 2:
        names = (LAG, str(rng.choice(_WITH_LAG)))
    return NoiseCase(
        name=f"noise-{kind}-{'+'.join(names) or 'nothing'}-{seed}",
        effects=tuple((name, SIZES[name] * float(rng.uniform(0.75, 1.3))) for name in names),
        unlisted=(),
        seed=seed,
        makers=tuple(MAKERS[name] for name in names),
        rig_name=PAPER_RIG,
        rate_Hz=RATES_Hz[int(rng.integers(len(RATES_Hz)))],
        gentle=False,
        controller=CONTROLLERS[int(rng.integers(len(CONTROLLERS)))],
        disturbances=UNDISTURBED,
        kind=kind,
    )


@dataclass
class NoiseCounts:
    """Counts of one kind of noise."""

    nothing: int = 0
    """nothing, explained: Cases with nothing hidden, and those of them that are ``explained``."""
    explained: int = 0
    hidden: int = 0  # hidden, named: Hidden causes, and those of them that are named
    named: int = 0
    false_names: int = 0  # Names of causes that are not hidden
    named_but_unexplained: int = 0  # Cases that are ``unexplained`` although every hidden cause is named
    cases: int = 0  # All cases
    cpu_s: float = 0.0  # Their processor time

    def add(self, case: NoiseCase, result: Mapping[str, Any], cpu_s: float) -> None:
        """Count the `result` of a `case`, which took `cpu_s` of processor time."""
        causes = {cause["effect"] for cause in result["causes"]}
        hidden = {id_ for id_, _ in case.effects}
        self.cases, self.cpu_s = self.cases + 1, self.cpu_s + cpu_s
        self.nothing += not hidden
        self.explained += not hidden and result["verdict"] == "explained"
        self.hidden += len(hidden)
        self.named += len(hidden & causes)
        self.false_names += len(causes - hidden)
        self.named_but_unexplained += hidden <= causes and result["verdict"] == "unexplained"

    def __str__(self) -> str:
        return (
            f"explained {self.explained} of {self.nothing}, causes named {self.named} of {self.hidden}, "
            f"false names {self.false_names}, all named but unexplained {self.named_but_unexplained} of "
            f"{self.cases}, {self.cpu_s / max(self.cases, 1):.1f} s"
        )


def main() -> None:
    """Diagnose the cases of all seeds, and print one row per case and one per kind."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("seeds", nargs="*", type=int, default=list(range(8000, 8020)))
    options = parser.parse_args()
    counts = {kind: NoiseCounts() for kind in NOISE_KINDS}
    for case, result, cpu_s in diagnosed_cases(map(noise_case, options.seeds)):
        counts[case.kind].add(case, result, cpu_s)
        causes = ", ".join(f"{cause['effect']} ({cause['confidence']:.2f})" for cause in result["causes"])
        print(f"{case.name:55} {result['verdict']:12} {cpu_s:5.1f} s  {causes}", flush=True)
    for kind, count in counts.items():
        print(f"{kind:10} {count}")


if __name__ == "__main__":
    main()
