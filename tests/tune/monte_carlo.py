"""`python -m tests.tune.monte_carlo`: the board's defaults on random rigs, as a campaign."""

from __future__ import annotations

import argparse
import functools
import os
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from heli_host.declaration import Fault
from heli_lab.apps.campaign import Campaign, Case, Store, run_campaign
from heli_lab.apps.campaign.run import CampaignProgress
from heli_sim.model import MultibodyModel
from heli_sim.model.effects import RotorLag
from heli_sim.model.plant import Plant
from heli_sim.rig import Rig, load_rig

from tests.tune.pilot import SINE_S, demanding_path_deg, fly, with_numbers


@functools.cache
def lagging_plant() -> Plant:
    """The equations that every random rig flies."""
    return Plant(MultibodyModel((RotorLag(0.12),)), load_rig("makki2024"))


def random_rig(seed: int) -> tuple[Rig, float]:
    """Thrust within 20 %, every mass within 3 %, friction from half to double, lag up to 0.15 s."""
    random, rig = np.random.default_rng(seed), load_rig("makki2024")
    values = {name: rig[name].value * (1 + random.uniform(-0.03, 0.03)) for name in rig if name[:2] == "M_"}
    values["thrust_gain"] = rig["thrust_gain"].value * (1 + random.uniform(-0.2, 0.2))
    for axis in ("elevation", "pitch", "travel"):
        name = f"friction_{axis}"
        values[name] = rig[name].value * 2.0 ** random.uniform(-1, 1)
    return rig.replace(**values), max(random.uniform(0.0, 0.15), 0.001)


def faults_of(
    parameters: Mapping[str, float], seeds: Sequence[int], duration_s: float
) -> tuple[dict[int, Fault], float]:
    """First fault on each random rig that has one, by its seed, and the largest tilt of all, degrees."""
    faults, tilt_deg = {}, 0.0
    for seed in seeds:
        rig, lag_s = random_rig(seed)
        plant = with_numbers(lagging_plant(), rig, rotor_lag_s=lag_s)
        end = fly(plant, demanding_path_deg, duration_s, parameters, seed=seed)
        assert end.t_s.size == round(1e3 * duration_s), f"rig {seed} never took off"
        tilt_deg = max(tilt_deg, float(np.abs(end.angle_deg[:, 1]).max()))
        if end.first_fault:
            faults[seed] = end.first_fault
    return faults, tilt_deg


def flown(settings: Mapping[str, Any]) -> tuple[dict[str, Any], Any]:
    """A case of the campaign: random rigs from ``first`` on, ``count`` of them."""
    seeds = range(settings["first"], settings["first"] + settings["count"])
    faults, tilt_deg = faults_of({}, seeds, settings["duration_s"])
    names = {str(seed): fault.name for seed, fault in faults.items()}
    return {"rigs": len(seeds), "faults": len(faults), "tilt_max_deg": tilt_deg}, names


def main(arguments: Sequence[str] | None = None) -> int:
    """Fly all cases and print the result. Return 0 if every case ended and none reached a limit."""
    parser = argparse.ArgumentParser(prog="python -m tests.tune.monte_carlo", description=__doc__)
    parser.add_argument("--rigs", type=int, default=200)
    parser.add_argument("--together", type=int, default=20, help="rigs a case: they share the compiled step")
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--folder", type=Path, default=Path("build/tune"))
    given = parser.parse_args(arguments)
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    cases = tuple(
        Case(
            f"rigs from {first}",
            "tests.tune.monte_carlo:flown",
            {"first": first, "count": min(given.together, given.rigs - first), "duration_s": SINE_S},
        )
        for first in range(0, given.rigs, given.together)
    )

    def say(progress: CampaignProgress) -> None:
        print(f"{progress.ended}/{progress.cases}", flush=True)

    campaign = Campaign("tune", cases, worst="tilt_max_deg")
    rows = run_campaign(campaign, Store(given.folder), processes=given.processes, on_progress=say)
    failed = [row for row in rows if row.get("failure")]
    done = [row for row in rows if not row.get("failure")]
    faults = sum(int(row["faults"]) for row in done)
    tilt_deg = max((float(row["tilt_max_deg"]) for row in done), default=0.0)
    rigs = sum(int(row["rigs"]) for row in done)
    print(f"rigs {rigs}, limits hit on {faults}, largest tilt {tilt_deg:.1f} deg")
    print("".join(f"{row['name']}: {row['failure']}\n" for row in failed), end="")
    return 1 if failed or faults else 0


if __name__ == "__main__":
    sys.exit(main())
