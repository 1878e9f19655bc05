"""Compare the angles at rest around healthy flights with each effect: ``python -m tests.fly.rest_angles``."""

import argparse
from typing import Final
from urllib.parse import quote

import heli_host
from heli_host.board.samples import Sample
from heli_host.fly.plan import Plan
from heli_host.fly.runner import fly
from heli_sim.model.effects.catalogue import catalogue

PLAN: Final = Plan.parse(
    """
[start]
settle_s = 2
[[segment]]
kind = "sine"
travel_amplitude_deg = 20
travel_period_s = 12
elevation_amplitude_deg = 5
elevation_period_s = 8
duration_s = 16
[[segment]]
kind = "step"
travel_deg = 8
duration_s = 6
""",
    "rest.toml",
)


def flown(effects: str, seed: int) -> tuple[str, Sample, Sample]:
    """Return the outcome of a healthy flight, and a sample at rest before and after it."""
    with heli_host.connect(f"sil://?seed={seed}&effect={quote(effects)}") as heli:
        heli.wait(0.6)
        before = heli.latest
        outcome = fly(heli, PLAN).outcome
        return outcome, before, heli.latest


def main() -> None:
    """Print a line per effect and seed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--pairs", action="store_true", help="every effect together with each friction")
    options = parser.parse_args()
    names = list(catalogue())
    if options.pairs:
        frictions = [name for name in names if name.startswith("coulomb_friction")]
        names = [f"{friction};{other}" for friction in frictions for other in names if friction != other]
    for name in names:
        for seed in range(1, options.seeds + 1):
            outcome, before, after = flown(name, seed)
            print(
                f"{name:50} seed {seed}: elevation {after.elevation_deg - before.elevation_deg:+.2f}, "
                f"pitch {after.pitch_deg - before.pitch_deg:+.2f} deg; {outcome}",
                flush=True,
            )


if __name__ == "__main__":
    main()
