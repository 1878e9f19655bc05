"""Logs that are slower than the control loop: ``python -m tests.field.slow_logs [SEED...]``.

The flight code flies a simulated rig at 1 kHz. The log keeps every second, fourth or tenth row, with the
voltage of that row alone, as a slower logger does. A rig is healthy or has one plain cause; half of the rigs
are in gusts, and half of the boards have rate filters that let more of the encoders' steps through to the
motors. Seeds 9000 to 9099 are for development. Seeds 9100 to 9159 and 9340 to 9399 (healthy), and 9160 to
9219 and 9400 to 9459 (one cause), judge.
"""

import argparse
import sys
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from heli_benchmark.flights import plan
from heli_benchmark.runs.case import REFITS
from heli_host.data.flight import Flight
from heli_host.declaration import PARAMS
from heli_host.errors import FlightAborted
from heli_lab.diagnose import diagnose, to_json
from heli_sim.errors import SimError
from heli_sim.model import MultibodyModel
from heli_sim.model.effects import parse_effects
from heli_sim.rig import load_rig

from tests.identify.made import flown_by_plan, perturbed
from tests.running.alone import one_thread_each

DURATIONS_s: Final = (60.0, 40.0)
THINNINGS: Final = (2, 4, 10)
CAUSES: Final[Mapping[str, float]] = {
    "rotor_lag": 0.1,
    "input_delay": 0.03,
    "thrust_asymmetry": 0.1,
    "coulomb_friction.elevation": 0.05,
    "coulomb_friction.travel": 0.03,
    "cable_spring.travel": 0.1,
    "axis_tilt": 0.05,
    "travel_drag_quadratic": 0.4,
}
"""Causes with their sizes in the units of the catalogue: plain in gusts of the strengths below."""
_SIZES: Final = (0.75, 1.3)
_GUSTS_Nm: Final = (0.012, 0.004, 0.008)
"""Moderate gusts about elevation, pitch and travel."""
_FOLLOWING_deg: Final = 180.0
"""The board does not end the flight of a rig that follows its setpoint badly."""
_FILTERS_Hz: Final = {spec.name: spec.default for spec in PARAMS if spec.name.endswith("_filter_Hz")}
_FILTERS: Final = (1.0, 3.0)
"""Factors of the cut-off frequencies of the board's rate filters."""
_HEALTHY: Final = (range(9000, 9050), range(9100, 9160), range(9340, 9400))
"""Seeds without a cause; all others have one."""
SIZE_STD: Final = 3.0
"""Standard errors by which a size may be wrong: one in 370 by chance."""


@dataclass(frozen=True)
class SlowLog:
    """A rig with a cause or none, and how its flights are logged."""

    # `seed`: Seed of rig and flights.
    # `cause`: Id of the cause; empty if there is none.
    # `size`: Size of the cause, in the unit of the catalogue.
    # `gusts`: Strength of the gusts, as a share of moderate ones.
    # `filters`: Factor of the cut-off frequencies of the board's rate filters.
    # `thinning`: The log has one of so many rows.

    seed: int
    cause: str
    size: float
    gusts: float
    filters: float
    thinning: int

    @property
    def name(self) -> str:
        """Name for tables."""
        gusts = f"gusts-{self.gusts:.1f}" if self.gusts else "calm"
        return f"{self.cause or 'nothing'}-{gusts}-filters-{self.filters:g}-by-{self.thinning}-{self.seed}"

    def at_loop_rate(self) -> tuple[Flight, Flight]:
        """Fly both flights, with every row of the loop."""
        effects = [f"{self.cause}={self.size!r}"] if self.cause else []
        if self.gusts:
            effects += [
                f"random_torque.{axis}={self.gusts * strength_Nm!r}"
                for axis, strength_Nm in zip(("elevation", "pitch", "travel"), _GUSTS_Nm, strict=True)
            ]
        model, rig = MultibodyModel(parse_effects(effects)), perturbed(self.seed)
        first, second = (
            flown_by_plan(
                rig,
                10 * self.seed + number,
                plan(f"{self.seed}", duration_s, np.random.default_rng([self.seed, number])),
                model,
                parameters={
                    "travel_following_max_deg": _FOLLOWING_deg,
                    **{name: self.filters * value for name, value in _FILTERS_Hz.items()},
                },
            )
            for number, duration_s in enumerate(DURATIONS_s)
        )
        return first, second

    def flights(self) -> tuple[Flight, Flight]:
        """Fly both flights, as they are logged."""
        first, second = (every(flight, self.thinning) for flight in self.at_loop_rate())
        return first, second


def slow_log(seed: int) -> SlowLog:
    """Draw the case of a `seed`."""
    random = np.random.default_rng([seed, 21])
    cause = str(random.choice(list(CAUSES)))
    if any(seed in seeds for seeds in _HEALTHY):
        cause = ""
    return SlowLog(
        seed,
        cause,
        size=CAUSES[cause] * float(random.uniform(*_SIZES)) if cause else 0.0,
        gusts=float(random.uniform(0.5, 1.5)) if seed % 2 else 0.0,
        filters=_FILTERS[int(random.integers(len(_FILTERS)))],
        thinning=THINNINGS[seed // 2 % len(THINNINGS)],
    )


def every(flight: Flight, thinning: int) -> Flight:
    """Keep one of `thinning` rows of a flight, with the voltages of that row alone."""
    rows = slice(None, None, thinning)
    return Flight(
        flight.t_s[rows], flight.front_V[rows], flight.back_V[rows], *flight.angles_rad[rows].T.copy()
    )


def outcome(case: SlowLog, result: Mapping[str, Any]) -> str:
    """Classify a diagnosis: ``right``, ``wrong verdict``, ``wrong size``, ``missed`` or ``false name``."""
    causes = {cause["effect"]: cause["parameters"] for cause in result["causes"]}
    hidden = {case.cause} - {""}
    if set(causes) - hidden:
        return "false name"
    if hidden - set(causes):
        return "missed"
    if not hidden:
        return "right" if result["verdict"] == "explained" else "wrong verdict"
    number = next(iter(causes[case.cause].values()))
    return "right" if abs(number["value"] - case.size) <= SIZE_STD * number["std"] else "wrong size"


def main(arguments: Sequence[str] | None = None) -> int:
    """Diagnose the cases, and print one row per case and the counts."""
    parser = argparse.ArgumentParser(prog="python -m tests.field.slow_logs", description=__doc__)
    parser.add_argument("seeds", nargs="*", type=int, default=list(range(9000, 9006)))
    options = parser.parse_args(arguments)
    one_thread_each()
    counts: Counter[tuple[str, str]] = Counter()
    for case in map(slow_log, options.seeds):
        try:
            fitted, held_out = case.flights()
        except (FlightAborted, SimError, AssertionError) as error:
            print(f"{case.name:60} not flown: {error}", flush=True)
            continue
        started_s = time.process_time()
        diagnosis = diagnose(
            MultibodyModel(), load_rig("makki2024"), [fitted], [held_out], labels=["a", "b"], refits=REFITS
        )
        result, spent_s = to_json(diagnosis), time.process_time() - started_s
        word = outcome(case, result)
        counts["one cause" if case.cause else "healthy", word] += 1
        causes = ", ".join(f"{cause['effect']} ({cause['confidence']:.2f})" for cause in result["causes"])
        print(f"{case.name:60} {word:13} {result['verdict']:12} {spent_s:5.1f} s  {causes}", flush=True)
    for (group, word), count in sorted(counts.items()):
        print(f"{group}: {word} {count}")
    return 0 if all(word == "right" for _, word in counts) else 1


if __name__ == "__main__":
    sys.exit(main())
