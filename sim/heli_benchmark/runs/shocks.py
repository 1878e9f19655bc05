"""`python -m heli_benchmark.runs.shocks [SEED...]`: how many slips of the counterweight are named.

In one or both flights of a case, the counterweight slips at some moment. Each seed gives twelve cases: slips
of 10 and 30 mm, with and without disturbances, in three layouts of the flights. Seeds 5000 to 5099 are for
development; 6000 to 6099 judge.
"""

from __future__ import annotations

import argparse
import itertools
import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from heli_host.errors import FlightAborted
from heli_lab.diagnose import diagnose, to_json
from heli_sim.model import MultibodyModel
from heli_sim.rig import load_rig
from typing_extensions import override

from heli_benchmark.cases.clean import Stream
from heli_benchmark.cases.disturbed import PAPER_RIG, DisturbedCase, RATES_Hz
from heli_benchmark.effects.disturbances import CORRELATION_TIMES_s, DisturbanceModel, STRENGTHS_Nm
from heli_benchmark.flights import CONTROLLERS
from heli_benchmark.plant import HiddenEffect, Moment
from heli_benchmark.runs.case import REFITS

SHOCK_LAYOUTS: Final = ("fit", "both", "second")
"""The slip happens in the fitted flight alone; in the fitted and the validation flight, at different moments;
or in the second of two fitted flights, without a validation flight."""
SLIPS_m: Final = (0.01, 0.03)
UNDISTURBED: Final = DisturbanceModel((0.0, 0.0, 0.0), 0.6)
SLIP_EFFECT: Final = "counterweight_shift"


class Slip(HiddenEffect):
    """The counterweight slips outwards by `size` in m at `at_s`, or never if that is infinite."""

    def __init__(self, size: float, at_s: float) -> None:
        super().__init__(size, np.random.default_rng(0))
        self._at_s, self._slipped = at_s, False

    @override
    def during(self, at: Moment, model: Any) -> None:
        if at.flight_s >= self._at_s and not self._slipped:
            model.body("counterweight").pos[0] -= self.size
            self._slipped = True


@dataclass(frozen=True)
class ShockCase(DisturbedCase):
    """A slip of the counterweight on a rig of slightly different parameters."""

    slip_m: float = 0.0  # Distance of the slip outwards
    layout: str = "fit"  # Flights in which the slip happens, of `SHOCK_LAYOUTS`

    @property
    def moments_s(self) -> tuple[float, float]:
        """Moment of the slip in the first and in the second flight; infinite if it does not slip there."""
        second_s = float(Stream.SECOND_SLIP.rng(self.seed).uniform(12.0, 26.0))
        return {"fit": (30.0, np.inf), "both": (30.0, second_s), "second": (np.inf, second_s)}[self.layout]

    @override
    def hidden(self, flight: int = 0) -> list[HiddenEffect]:
        return [Slip(self.slip_m, self.moments_s[flight]), *super().hidden(flight)]


def shock_cases(seed: int) -> Iterator[ShockCase]:
    """Draw the twelve cases of a `seed`."""
    combinations = itertools.product(SLIPS_m, (False, True), SHOCK_LAYOUTS)
    for number, (slip_m, is_disturbed, layout) in enumerate(combinations):
        rng = np.random.default_rng([seed, number])
        gusts_Nm = STRENGTHS_Nm[int(rng.integers(3))]
        correlation_time_s = CORRELATION_TIMES_s[int(rng.integers(3))]
        yield ShockCase(
            name=f"slip-{1e3 * slip_m:.0f}mm-{'disturbed' if is_disturbed else 'calm'}-{layout}-{seed}",
            effects=(),
            unlisted=(),
            seed=100 * seed + number,
            makers=(),
            rig_name=PAPER_RIG,
            rate_Hz=RATES_Hz[int(rng.integers(3))],
            gentle=False,
            controller=CONTROLLERS[int(rng.integers(3))],
            disturbances=DisturbanceModel(gusts_Nm, correlation_time_s) if is_disturbed else UNDISTURBED,
            slip_m=slip_m,
            layout=layout,
        )


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
