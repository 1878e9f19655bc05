"""The cases in weather: rigs of two kinds, other controllers, gentle flights, one to four causes or none."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from heli_host.flight import Flight
from heli_host.log.table import write_csv
from heli_sim.rig import Rig, load_rig

from tests.blind.cases import TRAIN_S, VALIDATE_S, Case
from tests.blind.course import Course, Watching
from tests.blind.hidden import LISTED, MORE_LISTED, Maker
from tests.blind.measured_effects import MEASURED_EFFECTS
from tests.blind.mujoco_rig import Hidden
from tests.blind.off_list import IN_WEATHER
from tests.blind.tracking import CONTROLLERS, Route, tracked
from tests.blind.weather import Air, MEMORIES_s, STRENGTHS_Nm, Weather

PAPER, COURSE = "makki2024", "quanser-course"
RATES_Hz = (100, 250, 500)
LAG, SPEED_LAG = "rotor_lag", "rotor_speed_lag"
_NOTHING = 42
_GENTLE, _ON_COURSE, _DRIFTING = 0.2, 0.3, 0.35
"""Shares of the cases."""
_LARGER = (0.7, 1.0, 1.6)
"""Sizes go with the strength of the weather, so that most causes can be seen in any."""
_GENTLE_LARGER = 1.6
"""And with what a flight shows."""
_PAPER_ONLY = ("ground_effect", "edgewise_flow", "zero_offset", "removed")
"""What is made for the paper's arm, or is a number of the course's rig file."""

SIZES: dict[str, float] = {
    **{name: large for name, (_, _, large) in (LISTED | MORE_LISTED).items()},
    **{name: typical for name, (_, typical) in MEASURED_EFFECTS.items()},
    "rotor_lag": 0.11,
    "coulomb_friction.elevation": 0.06,
    "cable_spring.elevation": 0.3,
}
"""What is hidden in a draughty room. Chance torques are the weather itself."""
_MAKERS: dict[str, Maker] = {
    **{name: maker for name, (maker, _, _) in (LISTED | MORE_LISTED).items()},
    **{name: maker for name, (maker, _) in MEASURED_EFFECTS.items()},
    **{name: maker for name, (maker, _) in IN_WEATHER.items()},
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
"""Without a lag, for once."""
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


@dataclass(frozen=True)
class WeatherCase(Case):
    """Something hidden, or nothing, on a rig in weather.

    Parameters
    ----------
    rig_name : str
        What is known of the rig beforehand.
    rate_Hz : int
        Of log and controller.
    gentle : bool
        Whether the flights are.
    controller : str
        Which one flies.
    weather : Weather
        Of both flights; no gust comes twice.
    """

    rig_name: str
    rate_Hz: int
    gentle: bool
    controller: str
    weather: Weather

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
        if self.rig_name == COURSE:
            # Its file states travel's friction and leaves out what its flights show.
            values["friction_travel"] = rig["friction_travel"].value * rng.uniform(0.7, 1.4)
            values["dead_zone"] = rng.uniform(0.0, 0.3)
            values |= {"L_theta": rng.uniform(0.02, 0.05), "L_phi": rng.uniform(0.002, 0.006)}
            values |= {"torque_elevation": rng.uniform(-0.1, 0.1), "torque_pitch": rng.uniform(-0.02, 0.02)}
            values["torque_travel"] = rig["torque_travel"].value + rng.uniform(-0.04, 0.04)
            values |= {f"offset_{axis}": rng.uniform(-1.5, 1.5) for axis in ("elevation", "pitch")}
        return rig.replace(**values)

    def hidden(self, flight: int = 0) -> list[Hidden]:
        """Make what is hidden, and the weather of this flight last.

        Parameters
        ----------
        flight : int
            Number of the flight, for the weather.
        """
        air = Air(self.weather, np.random.default_rng([self.seed, 7, flight]))
        return [*super().hidden(flight), air]

    def flown(self, flight: int, duration_s: float) -> tuple[Flight, Course]:
        """Fly one of the two flights, with somebody looking on.

        Parameters
        ----------
        flight : int
            0 to learn from, 1 to hold out.
        duration_s : float
            How long it lasts.

        Returns
        -------
        tuple of Flight and Course
            The log, and what no log has.
        """
        return _flown(self, flight, duration_s)

    def route(self, flight: int, duration_s: float) -> Route:
        """Where a flight of so many seconds goes; the one held out goes another way.

        Parameters
        ----------
        flight : int
            0 or 1.
        duration_s : float
            How long it lasts.
        """
        rng = np.random.default_rng([self.seed, 8])
        travel_deg, elevation_deg = rng.uniform(40.0, 75.0, 2), rng.uniform(10.0, 15.0, 2)
        if self.gentle:
            travel_deg, elevation_deg = 0.45 * travel_deg, 0.35 * elevation_deg
        # The course's rotors give a quarter of the thrust for each volt.
        excitation_V = rng.uniform(0.12, 0.3) * (2.5 if self.rig_name == COURSE else 1.0)
        swings = bool(rng.integers(2))
        return Route(
            duration_s,
            float(travel_deg[flight]),
            float(elevation_deg[flight]),
            swings == (flight == 0),
            excitation_V * (0.4 if self.gentle else 1.0),
        )

    def flights(
        self, folder: Path, durations_s: tuple[float, float] = (TRAIN_S, VALIDATE_S)
    ) -> tuple[Path, Path]:
        """Fly both flights, unless they are there, each of so many seconds, and keep them in `folder`."""
        paths = (folder / self.name / "a.csv.gz", folder / self.name / "b.csv.gz")
        # The one to learn from last: whoever asks how visible the causes are asks for its course next.
        for number in (1, 0):
            path = paths[number]
            if path.exists():
                continue
            path.parent.mkdir(parents=True, exist_ok=True)
            unfinished = path.with_name("unfinished-" + path.name)
            write_csv(self.flown(number, durations_s[number])[0], unfinished)
            unfinished.rename(path)
        return paths


@lru_cache(maxsize=1)
def _flown(case: WeatherCase, flight: int, duration_s: float) -> tuple[Flight, Course]:
    watching = Watching()
    log = tracked(
        case.rig(),
        load_rig(case.rig_name),
        [watching, *case.hidden(flight)],
        case.route(flight, duration_s),
        controller=case.controller,
        rate_Hz=case.rate_Hz,
        rng=np.random.default_rng([case.seed, 4, flight]),
    )
    return log, watching.course()


def weather_cases() -> list[WeatherCase]:
    """All of them, in an order in which the first are a fair sample of all."""
    cases = list(_in_order())
    return [cases[i] for i in np.random.default_rng(2).permutation(len(cases))]


def _in_order() -> Iterator[WeatherCase]:
    seed = 3000
    for number in range(_NOTHING):
        seed += 1
        yield _case(f"w-nothing-{number}", seed, (), ())
    for number in range(4):
        seed += 1
        yield _case(f"w-lag-{number}", seed, (LAG,), ())
    for name in SIZES:
        if name not in (LAG, SPEED_LAG) and not name.startswith("random_torque"):
            seed += 1
            yield _case(f"w-lag+{name}", seed, (LAG, name), ())
    for name in _ALONE:
        seed += 1
        yield _case(f"w-{name}", seed, (name,), ())
    for names in _SEVERAL:
        seed += 1
        yield _case("w-" + "+".join(names).replace(LAG, "lag"), seed, names, ())
    for law in IN_WEATHER:
        for beside in ((LAG,), ()):
            seed += 1
            yield _case("w-" + "lag+" * len(beside) + f"off-{law}", seed, beside, (law,))


def _case(name: str, seed: int, effects: Sequence[str], laws: Sequence[str]) -> WeatherCase:
    """Draw rig, flight and weather of a case, and the sizes that go with them."""
    rng = np.random.default_rng([seed, 6])
    strength = int(rng.integers(3))
    gusts_Nm, memory_s = STRENGTHS_Nm[strength], MEMORIES_s[int(rng.integers(3))]
    drifts, on_course = rng.random() < _DRIFTING, rng.random() < _ON_COURSE
    drift = [float(share * gust) for share, gust in zip(rng.uniform(0.5, 1.0, 3), gusts_Nm, strict=True)]
    weather = Weather(
        gusts_Nm,
        memory_s,
        (drift[0], drift[1], drift[2]) if drifts else (0.0, 0.0, 0.0),
        float(rng.uniform(20.0, 40.0)),
    )
    gentle = bool(rng.random() < _GENTLE)
    rate_Hz = RATES_Hz[int(rng.integers(3))]
    controller = CONTROLLERS[int(rng.integers(3))]
    if any(one.startswith(_PAPER_ONLY) for one in effects):
        on_course = False
    larger = _LARGER[strength] * (_GENTLE_LARGER if gentle else 1.0)
    sized = [(one, _size(one, SIZES[one], larger, rng)) for one in effects]
    off = [(law, _size(law, IN_WEATHER[law][1], larger, rng)) for law in laws]
    return WeatherCase(
        name,
        tuple(sized),
        tuple(off),
        seed,
        tuple(_MAKERS[one] for one in (*effects, *laws)),
        COURSE if on_course else PAPER,
        rate_Hz,
        gentle,
        controller,
        weather,
    )


def _size(name: str, typical: float, larger: float, rng: np.random.Generator) -> float:
    # A lag is as long as the rotors are heavy, whatever the weather.
    if name in (LAG, SPEED_LAG, "input_delay"):
        larger = 1.0
    return typical * larger * float(rng.uniform(0.75, 1.3))
