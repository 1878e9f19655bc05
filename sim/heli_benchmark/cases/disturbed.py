"""Cases with disturbances: rigs within their tolerances, three controllers, up to four causes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from heli_host.data.flight import Flight
from heli_host.data.log.table import write_csv
from heli_sim.rig import Rig, load_rig

from heli_benchmark.cases.clean import TRAIN_S, VALIDATE_S, Case, Stream
from heli_benchmark.effects.disturbances import (
    CORRELATION_TIMES_s,
    DisturbanceModel,
    DisturbanceTorques,
    STRENGTHS_Nm,
)
from heli_benchmark.effects.listed import LISTED, MEASURED_EFFECTS, MORE_LISTED, Maker
from heli_benchmark.effects.unlisted import DISTURBED
from heli_benchmark.flights import CONTROLLERS, Route, tracked
from heli_benchmark.plant import HiddenEffect, TrajectoryRecorder, TrueTrajectory

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
        rng = Stream.RIG.rng(self.seed)
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
        disturbances = DisturbanceTorques(self.disturbances, Stream.DISTURBANCES.rng(self.seed, flight))
        return [*super().hidden(flight), disturbances]

    def fly(self, flight: int, duration_s: float) -> tuple[Flight, TrueTrajectory]:
        """Fly one of the two flights, and record its true trajectory."""
        return _fly_and_record_truth(self, flight, duration_s)

    def route(self, flight: int, duration_s: float) -> Route:
        """Draw the route of a flight; the validation flight has another one."""
        rng = Stream.ROUTE.rng(self.seed)
        travel_deg, elevation_deg = rng.uniform(40.0, 75.0, 2), rng.uniform(10.0, 15.0, 2)
        if self.gentle:
            travel_deg, elevation_deg = 0.45 * travel_deg, 0.35 * elevation_deg
        # The rotors of the Quanser rig give a quarter of the thrust per volt.
        excitation_V = rng.uniform(0.12, 0.3) * (2.5 if self.rig_name == QUANSER_RIG else 1.0)
        # One of the two flights follows sines, the other steps.
        training_has_sines = bool(rng.integers(2))
        is_training = flight == 0
        return Route(
            duration_s,
            travel_deg=float(travel_deg[flight]),
            elevation_deg=float(elevation_deg[flight]),
            sines=training_has_sines if is_training else not training_has_sines,
            excitation_V=excitation_V * (0.4 if self.gentle else 1.0),
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
        rng=Stream.FLOWN_PLAN.rng(case.seed, flight),
    )
    return log, recorder.trajectory()


PAPER_RIG = "makki2024"
RATES_Hz = (100, 250, 500)
LAG, SPEED_LAG = "rotor_lag", "rotor_speed_lag"
_NOTHING = 42
_GENTLE, _ON_QUANSER, _DRIFTING = 0.25, 0.3, 0.35
"""Shares of the cases with weak excitation, on the other rig, and with a slow drift."""
STRENGTH_FACTORS = (0.7, 1.0, 1.6)
"""Factors of the sizes by strength of the disturbances, so that most causes are visible in any."""
WEAK_EXCITATION_FACTOR = 1.6
"""Factor of the sizes in flights with weak excitation."""
PAPER_RIG_ONLY = (
    *("ground_effect", "edgewise_flow"),
    *("zero_offset", "cable_spring.elevation", "rotor_reaction_torque"),
)
"""Effects that need the dimensions of the paper's rig, or that the tolerances of the other rig include."""
STRONGLY_EXCITED_ONLY = (
    *("travel_drag_quadratic", "pitch_drag_quadratic", "gyroscopic_torque", "flywheel", "inflow_damping"),
    *("edgewise_flow", "encoder_eccentricity", "rotor_reaction_torque", "cable_spring.elevation"),
    *(law for law in DISTURBED if law not in ("bumpy_pitch", "hysteretic_thrust")),
)
"""Effects that weak excitation shows at no realistic size."""

SIZES: dict[str, float] = {
    **{name: large for name, (_, _, large) in (LISTED | MORE_LISTED).items()},
    **{name: typical for name, (_, typical) in MEASURED_EFFECTS.items()},
    "rotor_lag": 0.11,
    "input_delay": 0.045,
    "thrust_asymmetry": 0.12,
    "supply_sag": 0.12,
    "inflow_damping": 0.5,
    "ground_effect": 1.0,
    "rotor_reaction_torque": 0.06,
    "coulomb_friction.elevation": 0.06,
    "travel_drag_quadratic": 0.5,
    "cable_spring.elevation": 0.7,
    "axis_tilt": 4.0,
    "backlash.elevation": 0.3,
    "backlash.pitch": 0.3,
    "backlash.travel": 0.3,
    "encoder_eccentricity.travel": 4.0,
    "edgewise_flow": 0.25,
    "gyroscopic_torque": 0.06,
}
"""Sizes under moderate disturbances, in the unit of the effect."""
NEVER_DRAWN = ("random_torque", "encoder_eccentricity.elevation", "encoder_eccentricity.pitch")
"""Random torques are disturbances; over a few degrees an eccentricity of second order is a scale."""
MAKERS: dict[str, Maker] = {
    **{name: listed.maker for name, listed in (LISTED | MORE_LISTED).items()},
    **{name: maker for name, (maker, _) in MEASURED_EFFECTS.items()},
    **{name: unlisted.maker for name, unlisted in DISTURBED.items()},
}
_ALONE = (
    *(
        "input_delay",
        "thrust_asymmetry",
        "inflow_damping",
        "coulomb_friction.elevation",
        "cable_spring.travel",
    ),
    *("rotor_reaction_torque", "backlash.pitch", "travel_drag_quadratic", "thrust_step.back", "axis_tilt"),
)
"""Effects that also appear without a lag."""
_SEVERAL = (
    (LAG, "coulomb_friction.elevation", "cable_spring.travel"),
    (LAG, "thrust_asymmetry", "coulomb_friction.travel"),
    (LAG, "gyroscopic_torque", "travel_drag_quadratic"),
    (LAG, "inflow_damping", "coulomb_friction.pitch"),
    (LAG, "rotor_reaction_torque", "cable_spring.elevation"),
    (LAG, "axis_tilt", "thrust_fade"),
    ("thrust_asymmetry", "cable_spring.elevation"),
    ("coulomb_friction.travel", "rotor_reaction_torque"),
    (LAG, "thrust_asymmetry", "coulomb_friction.pitch", "cable_spring.travel"),
    (LAG, "gyroscopic_torque", "coulomb_friction.elevation", "travel_drag_quadratic"),
    (LAG, "edgewise_flow", "coulomb_friction.travel", "thrust_step.front"),
    (LAG, "inflow_damping", "axis_tilt", "backlash.elevation"),
    (SPEED_LAG,),
    (SPEED_LAG, "coulomb_friction.travel"),
    (SPEED_LAG, "cable_spring.elevation"),
    (SPEED_LAG, "flywheel", "coulomb_friction.pitch"),
)


def disturbed_cases() -> list[DisturbedCase]:
    """Return all cases, in an order in which the first are a fair sample of all."""
    cases = list(_cases_by_kind())
    return [cases[i] for i in np.random.default_rng(2).permutation(len(cases))]


def _cases_by_kind() -> Iterator[DisturbedCase]:
    """Yield the cases by kind; each has a fixed seed."""
    seed = 3000
    for number in range(_NOTHING):
        seed += 1
        yield _draw_case(f"w-nothing-{number}", seed, (), ())
    for number in range(4):
        seed += 1
        yield _draw_case(f"w-lag-{number}", seed, (LAG,), ())
    for name in SIZES:
        if name not in (LAG, SPEED_LAG) and not name.startswith(NEVER_DRAWN):
            seed += 1
            yield _draw_case(f"w-lag+{name}", seed, (LAG, name), ())
    for name in _ALONE:
        seed += 1
        yield _draw_case(f"w-{name}", seed, (name,), ())
    for names in _SEVERAL:
        seed += 1
        yield _draw_case("w-" + "+".join(names).replace(LAG, "lag"), seed, names, ())
    for equation in DISTURBED:
        for listed in ((LAG,), ()):
            seed += 1
            yield _draw_case("w-" + "lag+" * len(listed) + f"off-{equation}", seed, listed, (equation,))


def _draw_case(name: str, seed: int, effects: Sequence[str], equations: Sequence[str]) -> DisturbedCase:
    """Draw rig, flight and disturbances of a case, and the sizes that suit them."""
    rng = Stream.DISTURBED_CASE.rng(seed)
    # The order of the draws determines the cases, so a draw that a case does not use is made too.
    strength = int(rng.integers(len(STRENGTHS_Nm)))
    gusts_Nm = STRENGTHS_Nm[strength]
    correlation_time_s = CORRELATION_TIMES_s[int(rng.integers(len(CORRELATION_TIMES_s)))]
    is_drifting, is_quanser = rng.random() < _DRIFTING, rng.random() < _ON_QUANSER
    elevation_Nm, pitch_Nm, travel_Nm = map(float, rng.uniform(0.5, 1.0, 3) * gusts_Nm)
    disturbances = DisturbanceModel(
        gusts_Nm,
        correlation_time_s,
        slow_std_Nm=(elevation_Nm, pitch_Nm, travel_Nm) if is_drifting else (0.0, 0.0, 0.0),
        drift_s=float(rng.uniform(20.0, 40.0)),
    )
    is_weak = bool(rng.random() < _GENTLE)
    rate_Hz = RATES_Hz[int(rng.integers(len(RATES_Hz)))]
    controller = CONTROLLERS[int(rng.integers(len(CONTROLLERS)))]
    if any(effect.startswith(PAPER_RIG_ONLY) for effect in effects):
        is_quanser = False
    if any(cause.startswith(STRONGLY_EXCITED_ONLY) for cause in (*effects, *equations)):
        is_weak = False
    size_factor = STRENGTH_FACTORS[strength] * (WEAK_EXCITATION_FACTOR if is_weak else 1.0)
    sized = [(name, _draw_size(name, SIZES[name], size_factor, rng)) for name in effects]
    sized_unlisted = [
        (equation, _draw_size(equation, DISTURBED[equation].size, size_factor, rng)) for equation in equations
    ]
    return DisturbedCase(
        name,
        effects=tuple(sized),
        unlisted=tuple(sized_unlisted),
        seed=seed,
        makers=tuple(MAKERS[cause] for cause in (*effects, *equations)),
        rig_name=QUANSER_RIG if is_quanser else PAPER_RIG,
        rate_Hz=rate_Hz,
        gentle=is_weak,
        controller=controller,
        disturbances=disturbances,
    )


def _draw_size(name: str, typical: float, larger: float, rng: np.random.Generator) -> float:
    # A lag depends on the rotors, not on the disturbances.
    if name in (LAG, SPEED_LAG, "input_delay"):
        larger = 1.0
    return typical * larger * float(rng.uniform(0.75, 1.3))
