"""`python -m heli_benchmark.runs.shocks [SEED...]`: how many slips of the counterweight are named."""

from __future__ import annotations

import argparse
import time
from typing import Any

from heli_host.errors import FlightAborted
from heli_lab.diagnose import diagnose, to_json
from heli_sim.model import MultibodyModel
from heli_sim.rig import load_rig

from heli_benchmark.cases.shocks import SLIP_EFFECT, ShockCase, shock_cases
from heli_benchmark.runs.ask import REFITS


def diagnose_shock(case: ShockCase) -> dict[str, Any]:
    """Diagnose the flights of a case; its layout states which of them are fitted and which are held out."""
    flights = case.both_flights()
    fitted, held_out = (flights, ()) if case.layout == "second" else (flights[:1], flights[1:])
    result = diagnose(
        MultibodyModel(), load_rig(case.rig_name), fitted, held_out, labels=["a", "b"], refits=REFITS
    )
    return to_json(result)


def is_named(case: ShockCase, result: dict[str, Any]) -> bool:
    """Return whether a `result` names only the slip, with its size within three standard errors."""
    if [cause["effect"] for cause in result["causes"]] != [SLIP_EFFECT]:
        return False
    size = result["causes"][0]["parameters"][f"{SLIP_EFFECT}_m"]
    return bool(abs(size["value"] - case.slip_m) < 3.0 * max(size["std"], 1e-3 * case.slip_m))


def main() -> None:
    """Diagnose all cases of the seeds and print one row per case."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("seeds", nargs="*", type=int, default=[5000])
    parser.add_argument("--only", default="", help="cases whose name contains this text")
    options = parser.parse_args()
    right = total = 0
    for seed in options.seeds:
        for case in shock_cases(seed):
            if options.only not in case.name:
                continue
            try:
                case.both_flights()
            except FlightAborted as error:
                print(f"{case.name:36} not flown: {error}", flush=True)
                continue
            started_s = time.process_time()
            result = diagnose_shock(case)
            spent_s = time.process_time() - started_s
            named = is_named(case, result)
            total, right = total + 1, right + named
            causes = "; ".join(
                cause["effect"]
                + " "
                + " ".join(f"{v['value']:.4g}±{v['std']:.2g}" for v in cause["parameters"].values())
                for cause in result["causes"]
            )
            word = "named" if named else "MISSED"
            print(f"{case.name:36} {word:6} {result['verdict']:12} {spent_s:5.1f} s  {causes}", flush=True)
    print(f"{right} of {total} named")


if __name__ == "__main__":
    main()
