"""Run the experiments of the paper on the simulated rig, with the flight code and the link.

The paper states which axes its bench tests lock and from which angles they release pitch, but neither
voltages nor durations. They are chosen here so that the free axes move far without reaching a stop.
"""

from __future__ import annotations

import contextlib
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import casadi as ca
import numpy as np
from heli_host.board.heli import Heli
from heli_host.board.parameters import load_gains
from heli_host.board.rest_check import ANGLE_SHIFTED
from heli_host.data.arrays import Floats
from heli_host.data.flight import Flight
from heli_host.data.log.reader import read_log
from heli_host.declaration import AXES, Axes, State
from heli_host.fly.plan import Plan, take_off
from heli_host.fly.recorder import Recorder
from heli_host.fly.runner import Progress
from heli_sim.bench import SCALE_N, ThrustCurve
from heli_sim.model import MultibodyModel
from heli_sim.model.linear import trim
from heli_sim.model.plant import Plant
from heli_sim.rig import Rig
from heli_sim.rig.rig import count_rad
from heli_sim.sil.world import SilWorld

from heli_lab.errors import IdentifyError
from heli_lab.fit.records import Record
from heli_lab.simulated_board import WITHOUT_TRAVEL_CHECKS, connected, fly_and_read, world_of

TABLE_DEG: Final = -25.0
"""Elevation of the arm on its table [deg]."""
_HOVER_V: Final = 1.7
"""Voltage of each motor at which the rig of Table 2 hovers [V]."""
_HOVER_TOLERANCE_V: Final = 0.15
"""Largest deviation of the hover voltage [V]; beyond it the elevation steps end at a stop or on the table."""


@dataclass(frozen=True)
class BenchTest:
    """Experiment on a rig with some axes locked."""

    name: str  # Name in lists and records
    figure: int  # figure, panel: Its place in the paper, such as 16, ``(a)``
    panel: str
    locked: tuple[bool, bool, bool]  # Whether elevation, pitch and travel are locked
    elevation_deg: float = 0.0  # Initial elevation; all axes are locked until the test starts
    pitch_deg: float = 0.0  # Initial pitch
    front_V: float = 0.0  # front_V, back_V: Voltages during the test; if both are 0, the motors are off
    back_V: float = 0.0
    duration_s: float = 15.0  # Duration of the test


PITCH_RELEASES: Final = (
    BenchTest("pitch released from 13 deg", 16, "(a)", (True, False, True), pitch_deg=13.0),
    BenchTest("pitch released from 8.8 deg", 16, "(b)", (True, False, True), pitch_deg=8.8),
)
ELEVATION_STEPS: Final = tuple(
    BenchTest(
        f"elevation, {each_V} V each",
        17,
        panel,
        (False, True, True),
        elevation_deg=TABLE_DEG,
        front_V=each_V,
        back_V=each_V,
        duration_s=30.0,
    )
    for panel, each_V in (("(a)", 1.5), ("(b)", 1.7))
)
TRAVEL_STEPS: Final = (
    BenchTest(
        "travel, 1.85 V and 1.55 V",
        18,
        "(a)",
        (True, False, False),
        front_V=1.85,
        back_V=1.55,
        duration_s=7.5,
    ),
    BenchTest(
        "travel, 2.1 V and 1.6 V", 18, "(b)", (True, False, False), front_V=2.1, back_V=1.6, duration_s=5.5
    ),
)

THRUST_V: Final[tuple[float, ...]] = (0.5, *(float(volts) for volts in range(1, 11)))
"""Voltages of the thrust curve in Fig. 15 [V]."""


def check_rig(rig: Rig) -> None:
    """Check that the voltages of these tests suit a rig."""
    hover_V = float(np.mean(trim(MultibodyModel(), rig).volts_V))
    if abs(hover_V - _HOVER_V) > _HOVER_TOLERANCE_V:
        raise IdentifyError(
            f"the paper's tests and flights need a rig that hovers at {_HOVER_V:g} V per motor, but rig "
            f"'{rig.name}' hovers at {hover_V:.2f} V",
            "give makki2024 or a similar rig",
        )


def record_of(test: BenchTest, flight: Flight, rig: Rig) -> Record:
    """Convert the flight of a bench test to a record for fitting."""
    angles_deg = np.rad2deg(flight.angles_rad)
    elevation_deg, pitch_deg, travel_deg = (angles_deg[:, axis] for axis in range(3))
    elevation_locked, pitch_locked, travel_locked = test.locked
    reaches_stop = (
        (not elevation_locked and elevation_deg.max() >= rig["elevation_max"].value)
        or (not pitch_locked and np.abs(pitch_deg).max() >= rig["pitch_max"].value)
        or (not travel_locked and np.abs(travel_deg).max() >= rig["travel_max"].value)
    )
    if reaches_stop:
        raise IdentifyError(
            f"{test.name}: rig '{rig.name}' reaches a stop; its parameters are too far from Table 2",
            "give makki2024 or a similar rig",
        )
    if flight.gaps.size:
        raise IdentifyError(f"{test.name}: rows are missing", "run the command again")
    return Record(
        label=test.name,
        t_s=flight.t_s,
        angles_rad=flight.angles_rad,
        voltages_V=flight.voltages_V,
        step_s=flight.step_s,
        count_rad=count_rad(rig),
        segments=((0, len(flight)),),
        cuts=(),
    )


class ThrustScale:
    """Scales under both rotors of a locked rig, with a resolution of one gram."""

    def __init__(self, plant: Plant) -> None:
        """Compile the thrust of both rotors of a plant as a function of state and voltages."""
        model = plant.model
        x, u = ca.SX.sym("x", len(model.states)), ca.SX.sym("u", 2)
        driven = model.driven(x, u, ca.SX(model.parameter_values(plant.rig)))
        self._thrust_N = ca.Function("thrust_N", [x, u], [driven.thrust_N])

    def read_N(self, state: Floats, volts_V: Sequence[float]) -> Floats:
        """Return the thrust of the front and the back rotor [N], shape (2,), rounded to the resolution.
        Shapes: `state` (n,).
        """
        exact = np.asarray(self._thrust_N(state, np.asarray(volts_V))).ravel()
        return np.round(exact / SCALE_N) * SCALE_N


_BOOT_S = 0.5
"""Simulated time after which the board has started [s]."""
_SETTLE_S = 1.0
"""Simulated time after which encoder filters and thrust have settled [s]."""
_MARGIN_TICKS = 20
"""Ticks that are left out after the release and before the end, because locks and voltages change there."""
_ALL_LOCKED = [True, True, True]
_END_S: Final = 0.1
"""Time at the end of a flight that is left out [s]: a streamed path arrives late on the board, and the
landing begins."""


_START = """
[start]
elevation_deg = 0
rate_deg_s = 15
settle_s = 4
"""
# The paper's text states neither amplitudes nor times; these stay within the stops of its rig.
PLANS: Final = {
    "hover": f"""
title = "Hover"
{_START}
[[segment]]
kind = "hold"
duration_s = 10
""",
    "irregular": f"""
title = "Irregular travel path, constant elevation"
{_START}
[[segment]]
kind = "waypoints"
path = "smooth"
points = [
  {{ at_s = 4, travel_deg = 20 }}, {{ at_s = 9, travel_deg = 20 }}, {{ at_s = 14, travel_deg = -10 }},
  {{ at_s = 18, travel_deg = 5 }}, {{ at_s = 23, travel_deg = 5 }}, {{ at_s = 30, travel_deg = 40 }},
  {{ at_s = 34, travel_deg = 30 }}, {{ at_s = 42, travel_deg = 0 }},
]
duration_s = 48
""",
    "sine": f"""
title = "Sines on travel and elevation"
{_START}
[[segment]]
kind = "sine"
elevation_amplitude_deg = 5
elevation_period_s = 15
travel_amplitude_deg = 25
travel_period_s = 20
duration_s = 60
""",
}
"""Plans of the flights behind Figs. 21 to 25, as TOML."""


@contextlib.contextmanager
def board_on(plant: Plant, seed: int, elevation_deg: float) -> Iterator[tuple[Heli, SilWorld]]:
    """Start a simulated board on a rig with level pitch, all axes locked, until the block ends."""
    world = world_of(plant, seed)
    state = world.state
    state[0] = np.deg2rad(elevation_deg)
    world.state = state
    world.native.locked = _ALL_LOCKED
    with connected(world) as heli:
        heli.params["elevation_rest_deg"] = elevation_deg
        heli.zero()
        heli.wait(_BOOT_S)
        yield heli, world


def run_bench_test(test: BenchTest, plant: Plant, seed: int = 1) -> Flight:
    """Run a bench test, and return its flight with one row per tick; time 0 is at the release."""
    powered = test.front_V > 0.0 or test.back_V > 0.0
    no_loops = Axes(0)  # constant voltages
    with board_on(plant, seed, test.elevation_deg) as (heli, world), tempfile.TemporaryDirectory() as folder:
        if powered:
            heli.arm()
            heli.control(no_loops)
        state = world.state
        state[AXES.index("pitch")] = np.deg2rad(test.pitch_deg)
        world.state = state
        heli.wait(_SETTLE_S)
        path = Path(folder) / "test.mcap"
        with Recorder(heli, path):
            if powered:
                heli.control(no_loops, test.front_V, test.back_V)
            world.native.locked = list(test.locked)
            # Board and simulation count the same milliseconds.
            release_tick = world.tick + _MARGIN_TICKS
            heli.wait(test.duration_s)
            last_tick = world.tick - _MARGIN_TICKS
            if powered:
                heli.stop()
            heli.wait(_BOOT_S)
        log = read_log(path)
    ticks, flight = log.ticks["tick"].astype(np.int64), log.flight()
    first_row, last_row = np.searchsorted(ticks, [release_tick, last_tick])
    test_flight = flight.between(float(flight.t_s[first_row]), float(flight.t_s[last_row]))
    return replace(test_flight, t_s=test_flight.t_s - test_flight.t_s[0])


def read_thrust(plant: Plant, seed: int = 1) -> ThrustCurve:
    """Measure thrust over voltage with scales under the rotors, at the voltages of Fig. 15, with locked
    axes.
    """
    scale = ThrustScale(plant)
    motor_volts_V, thrust_N = [], []
    with board_on(plant, seed, 0.0) as (heli, world):
        heli.params["motor_max_V"] = max(THRUST_V)
        heli.arm()
        for volts in THRUST_V:
            heli.control(Axes(0), volts, volts)
            heli.wait(_SETTLE_S)
            # The voltage that acts on the motors, which may differ from the command.
            motor_volts_V.append(world.native.volts_V)
            thrust_N.append(scale.read_N(world.state, world.native.volts_V))
    return ThrustCurve(np.array(motor_volts_V), np.array(thrust_N))


@dataclass(frozen=True)
class PaperFlight:
    """Closed-loop flight for a figure."""

    label: str  # Name of the gains
    flight: Flight  # Closed-loop part of a log; time 0 is the take-off
    desired_deg: Floats  # (n, 3): Planned elevation and travel, and the setpoint of the pitch loop [deg]
    outcome: str  # ``completed``, or the reason why the flight ended

    @property
    def error_deg(self) -> Floats:
        """Measured minus desired angles [deg], shape (n, 3)."""
        return np.rad2deg(self.flight.angles_rad) - self.desired_deg


def closed_loop_flight(label: str, flight: Flight, desired_deg: Floats, outcome: str) -> PaperFlight:
    """Cut out the closed-loop part of a log, from take-off to the end of the plan. Shapes: `desired_deg` (n,
    3).
    """
    names = {name: number for number, name in flight.state_names.items()}
    if flight.state is None or flight.setpoints_rad is None:
        raise IdentifyError(
            f"{label}: the log contains no states or setpoints", "record it with heli-host fly"
        )
    rows = np.flatnonzero(flight.state == names["closed_loop"])
    if rows.size == 0:
        raise IdentifyError(
            f"{label}: the board never closed its loops ({outcome})", "record a flight that takes off"
        )
    start_s, stop_s = float(flight.t_s[rows[0]]), float(flight.t_s[rows[-1]]) - _END_S
    closed_loop = flight.between(start_s, stop_s)
    is_closed_loop = (flight.t_s >= start_s) & (flight.t_s < stop_s)
    closed_loop_desired_deg = desired_deg[is_closed_loop].copy()
    # The travel loop gives the setpoint of pitch, and the plan does not.
    closed_loop_desired_deg[:, 1] = np.rad2deg(flight.setpoints_rad[is_closed_loop, 1])
    from_zero = replace(closed_loop, t_s=closed_loop.t_s - start_s)
    return PaperFlight(label, from_zero, closed_loop_desired_deg, outcome)


def fly_plan(
    name: str,
    plant: Plant,
    label: str,
    gains: str | None = None,
    seed: int = 1,
    on_progress: Callable[[float], None] | None = None,
) -> PaperFlight:
    """Fly one of the plans behind Figs. 21 to 25; a flight that ends with a fault is also returned. Without
    `gains`, a name or file, the board has its own; `on_progress` takes the completed share.
    """
    plan = Plan.parse(PLANS[name], f"plan {name}", name)
    length_s = plan.duration_s + plan.start.settle_s

    with board_on(plant, seed, TABLE_DEG) as (heli, world):

        def report(progress: Progress) -> None:
            """Release the arm when the loops close, and pass on the completed share of the flight."""
            # With the masses of Table 2, the arm without thrust balances above its table, so that it must be
            # locked until then.
            if progress.sample.state is State.CLOSED_LOOP:
                world.native.locked = [False, False, False]
            if on_progress is not None:
                on_progress(min(1.0, progress.t_s / length_s))

        load_gains(heli.params, gains)
        heli.params.restore(WITHOUT_TRAVEL_CHECKS)
        sample = heli.latest
        start_deg = np.array([sample.elevation_deg, sample.pitch_deg, sample.travel_deg])
        route = take_off([plan], dict(heli.params), start_deg)
        flight, summary = fly_and_read(heli, plan, report)
    closed_loop_rows = np.flatnonzero(flight.state == State.CLOSED_LOOP)
    start_s = float(flight.t_s[closed_loop_rows[0]]) if closed_loop_rows.size else 0.0
    # The arm was locked before the take-off, so its angles then are not those of its rest.
    outcome = "completed" if summary.outcome.startswith(ANGLE_SHIFTED) else summary.outcome
    return closed_loop_flight(label, flight, route.evaluate(flight.t_s - start_s), outcome)
