"""A case with disturbances: a rig within its tolerances, and two flights by other controllers."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from heli_host.data.flight import Flight
from heli_host.data.log.table import write_csv
from heli_sim.rig import Rig, load_rig

from heli_benchmark.cases.clean import TRAIN_S, VALIDATE_S, Case
from heli_benchmark.effects.disturbances import DisturbanceModel, DisturbanceTorques
from heli_benchmark.engine.plant import HiddenEffect
from heli_benchmark.engine.true_trajectory import TrajectoryRecorder, TrueTrajectory
from heli_benchmark.simulation.tracking import Route, tracked

QUANSER_RIG = "quanser-course"
"""Name of the rig of the other type, a Quanser rig of a trajectory."""


@dataclass(frozen=True)
class DisturbedCase(Case):
    """Something hidden, or nothing, in a rig under disturbances."""

    rig_name: str  # Name of the nominal rig
    rate_Hz: int  # Rate of log and controller
    gentle: bool  # Whether the flights excite the rig weakly
    controller: str  # Name of the controller that flies
    disturbances: DisturbanceModel  # Size and correlation in both flights; the random torques differ

    def rig(self) -> Rig:
        """Draw the true rig: thrust within 15 %, dead zone 10 %, friction half to double, masses 0.7 %."""
        rng = np.random.default_rng([self.seed, 1])
        rig = load_rig(self.rig_name)
        values = {"thrust_gain": rig["thrust_gain"].value * rng.uniform(0.85, 1.15)}
        values["dead_zone"] = rig["dead_zone"].value * rng.uniform(0.9, 1.1)
        for axis in ("elevation", "pitch", "travel"):
            values[f"friction_{axis}"] = rig[f"friction_{axis}"].value * 2.0 ** rng.uniform(-1.0, 1.0)
        for name in ("M_f", "M_b", "M_w", "M_h", "M_l"):
            values[name] = rig[name].value * rng.uniform(0.993, 1.007)
        if self.rig_name == QUANSER_RIG:
            # Its file lacks constant torques and offsets that its flights show.
            values["friction_travel"] = rig["friction_travel"].value * rng.uniform(0.7, 1.4)
            values["dead_zone"] = rng.uniform(0.0, 0.3)
            values |= {"L_theta": rng.uniform(0.02, 0.05), "L_phi": rng.uniform(0.002, 0.006)}
            values |= {"torque_elevation": rng.uniform(-0.1, 0.1), "torque_pitch": rng.uniform(-0.02, 0.02)}
            values["torque_travel"] = rig["torque_travel"].value + rng.uniform(-0.04, 0.04)
            values |= {f"offset_{axis}": rng.uniform(-1.5, 1.5) for axis in ("elevation", "pitch")}
        return rig.replace(**values)

    def hidden(self, flight: int = 0) -> list[HiddenEffect]:
        """Create the hidden effects, and the disturbances of this flight last."""
        disturbances = DisturbanceTorques(self.disturbances, np.random.default_rng([self.seed, 7, flight]))
        return [*super().hidden(flight), disturbances]

    def fly(self, flight: int, duration_s: float) -> tuple[Flight, TrueTrajectory]:
        """Fly one of the two flights, and record its true trajectory."""
        return _fly_and_record_truth(self, flight, duration_s)

    def route(self, flight: int, duration_s: float) -> Route:
        """Draw the route of a flight; the validation flight has another one."""
        rng = np.random.default_rng([self.seed, 8])
        travel_deg, elevation_deg = rng.uniform(40.0, 75.0, 2), rng.uniform(10.0, 15.0, 2)
        if self.gentle:
            travel_deg, elevation_deg = 0.45 * travel_deg, 0.35 * elevation_deg
        # The rotors of the Quanser rig give a quarter of the thrust per volt.
        excitation_V = rng.uniform(0.12, 0.3) * (2.5 if self.rig_name == QUANSER_RIG else 1.0)
        # One of the two flights follows sines, the other steps.
        training_has_sines = bool(rng.integers(2))
        return Route(
            duration_s,
            float(travel_deg[flight]),
            float(elevation_deg[flight]),
            training_has_sines == (flight == 0),
            excitation_V * (0.4 if self.gentle else 1.0),
        )

    def both_flights(self) -> tuple[Flight, Flight]:
        """Fly both flights, and return their logs."""
        return self.fly(0, TRAIN_S)[0], self.fly(1, VALIDATE_S)[0]

    def flights(
        self, folder: Path, durations_s: tuple[float, float] = (TRAIN_S, VALIDATE_S)
    ) -> tuple[Path, Path]:
        """Fly both flights, of `durations_s` seconds, into files of `folder`, unless these exist."""
        paths = (folder / self.name / "a.csv.gz", folder / self.name / "b.csv.gz")
        # The training flight last: the visibility of the causes needs its trajectory next.
        for number in (1, 0):
            path = paths[number]
            if path.exists():
                continue
            path.parent.mkdir(parents=True, exist_ok=True)
            unfinished = path.with_name("unfinished-" + path.name)
            write_csv(self.fly(number, durations_s[number])[0], unfinished, notes_inside=True)
            unfinished.rename(path)
        return paths


@lru_cache(maxsize=2)
def _fly_and_record_truth(
    case: DisturbedCase, flight: int, duration_s: float
) -> tuple[Flight, TrueTrajectory]:
    """Fly a case and record its true trajectory; the last two flights are kept in memory."""
    recorder = TrajectoryRecorder()
    log = tracked(
        case.rig(),
        load_rig(case.rig_name),
        [recorder, *case.hidden(flight)],
        case.route(flight, duration_s),
        controller=case.controller,
        rate_Hz=case.rate_Hz,
        rng=np.random.default_rng([case.seed, 4, flight]),
    )
    return log, recorder.trajectory()
