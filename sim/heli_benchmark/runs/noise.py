"""`python -m heli_benchmark.runs.noise [SEED...]`: verdicts under five kinds of noise."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from heli_benchmark.cases.noise import NOISE_KINDS, NoiseCase, noise_case
from heli_benchmark.runs.ask import diagnosed_cases


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
    spent_s: float = 0.0  # Their processor time

    def add(self, case: NoiseCase, result: Mapping[str, Any], spent_s: float) -> None:
        """Count the `result` of a `case`, which took `spent_s` of processor time."""
        causes = {cause["effect"] for cause in result["causes"]}
        hidden = {id_ for id_, _ in case.effects}
        self.cases, self.spent_s = self.cases + 1, self.spent_s + spent_s
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
            f"{self.cases}, {self.spent_s / max(self.cases, 1):.1f} s"
        )


def main() -> None:
    """Diagnose the cases of all seeds, and print one row per case and one per kind."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("seeds", nargs="*", type=int, default=list(range(8000, 8020)))
    options = parser.parse_args()
    counts = {kind: NoiseCounts() for kind in NOISE_KINDS}
    for case, result, spent_s in diagnosed_cases(map(noise_case, options.seeds)):
        counts[case.kind].add(case, result, spent_s)
        causes = ", ".join(f"{cause['effect']} ({cause['confidence']:.2f})" for cause in result["causes"])
        print(f"{case.name:55} {result['verdict']:12} {spent_s:5.1f} s  {causes}", flush=True)
    for kind, count in counts.items():
        print(f"{kind:10} {count}")


if __name__ == "__main__":
    main()
