"""Flights of the simulated board on rigs whose parameters only the test knows."""

import math
import tempfile
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from heli_host.board.heli import Heli
from heli_host.data.flight import Flight
from heli_host.data.log.reader import read_flight
from heli_host.errors import FlightAborted
from heli_host.fly.plan import Plan
from heli_host.fly.recorder import Recorder
from heli_host.fly.runner import fly
from heli_host.link.session import Session
from heli_sim.model import Model, MultibodyModel
from heli_sim.model.plant import Plant
from heli_sim.rig import Rig, load_rig
from heli_sim.sil.inprocess import InProcessTransport
from heli_sim.sil.options import SilOptions
from heli_sim.sil.world import SilWorld

SETPOINT_EVERY_S = 0.05
EXCITATION_V = 0.25


def perturbed(seed: int, rig: Rig | None = None) -> Rig:
    """Draw a rig from the tolerances of a rig file, by a `seed`."""
    # A parameter is normal about its value; its standard deviation is half of the tolerance. Gravity and
    # parameters without a tolerance stay.
    rig = load_rig("makki2024") if rig is None else rig
    random = np.random.default_rng(seed)
    values = {}
    for quantity in MultibodyModel().parameters:
        number = rig[quantity.name]
        if quantity.name == "g" or number.tolerance == 0.0:
            continue
        value = number.value + 0.5 * number.tolerance * random.standard_normal()
        values[quantity.name] = value if Rig.may_be_negative(quantity.name) else abs(value)
    return rig.replace(**values)


def hover_V(rig: Rig) -> float:
    """Return the sum of both voltages, above the dead zone, that holds the arm at level."""
    v = {name: rig[name].value for name in rig}
    arm_kg_m = (v["M_f"] + v["M_b"] + v["M_h"]) * v["L_a"] + v["M_l"] * v["L_x"] - v["M_w"] * v["L_b"]
    return (arm_kg_m * v["g"] - v["torque_elevation"]) / (v["L_a"] * v["thrust_gain"])


def flown(rig: Rig, seed: int, duration_s: float, model: Model | None = None) -> Flight:
    """Fly sines of travel and elevation, with a multisine on both motors, on a simulated rig."""
    # The flight code runs at 1 kHz with encoders and link. The `seed` determines amplitudes, periods, and the
    # start positions of the encoders. `model` is by default the multibody model.
    random = np.random.default_rng(seed)
    world = SilWorld(SilOptions(seed=seed), Plant(model or MultibodyModel(), rig, seed))
    session = Session(InProcessTransport(world))
    session.connect()
    travel_deg, travel_s = random.uniform(40.0, 60.0), random.uniform(12.0, 18.0)
    elevation_deg, elevation_s = random.uniform(6.0, 9.0), random.uniform(7.0, 11.0)
    with tempfile.TemporaryDirectory() as folder, Heli(session) as heli:
        path = Path(folder) / "flight.mcap"
        _prepare(heli, rig)
        with Recorder(heli, path):
            heli.take_off()
            heli.excite(
                "multisine", EXCITATION_V, EXCITATION_V, start_Hz=0.1, stop_Hz=4.0, duration_s=duration_s
            )
            for k in range(round(duration_s / SETPOINT_EVERY_S)):
                t_s = k * SETPOINT_EVERY_S
                heli.setpoint(
                    travel_deg=travel_deg * math.sin(2 * math.pi * t_s / travel_s),
                    elevation_deg=elevation_deg * math.sin(2 * math.pi * t_s / elevation_s),
                )
                heli.wait(SETPOINT_EVERY_S)
            heli.stop()
        return read_flight(path)


def flown_by_plan(
    rig: Rig,
    seed: int,
    plan: str | Path | Plan = "identify",
    model: Model | None = None,
    *,
    parameters: Mapping[str, float] | None = None,
) -> Flight:
    """Fly a `plan` on a simulated rig as `heli-host fly` does; the flight code runs at 1 kHz."""
    # `parameters` are those of the board.
    world = SilWorld(SilOptions(seed=seed), Plant(model or MultibodyModel(), rig, seed))
    session = Session(InProcessTransport(world))
    session.connect()
    with tempfile.TemporaryDirectory() as folder, Heli(session) as heli:
        path = Path(folder) / "flight.mcap"
        _prepare(heli, rig)
        for name, value in (parameters or {}).items():
            heli.params[name] = value
        summary = fly(heli, plan, log_path=path)
        if not (summary.completed or "landing_timeout" in summary.outcome):
            raise FlightAborted(summary.outcome)
        return read_flight(path)


def _prepare(heli: Heli, rig: Rig) -> None:
    """Set parameters with which every rig within its tolerances can be armed and fly."""
    # Some rigs rise from the table or turn before they are armed, so the limits for arming are wide.
    heli.params["hover_V"] = hover_V(rig)
    heli.params["travel_integral_max_deg"] = 20.0
    heli.params["pitch_setpoint_max_deg"] = 25.0
    heli.params["arm_elevation_tolerance_deg"] = 20.0
    heli.params["arm_rate_max_deg_s"] = 100.0


def encoder_zeros_deg(rig: Rig, seed: int) -> dict[str, float]:
    """Return the true encoder zeros of a simulated flight, which the simulation draws from its `seed`."""
    # At power-up, an encoder is at any position, and the board assumes that the arm lies at its rest. A
    # counter has whole numbers only. The zero is therefore the rig's own offset plus a part of a count.
    stand = np.random.default_rng(seed).uniform(-50_000.0, 50_000.0, 3)
    zeros = {}
    rests_deg = {"offset_elevation": rig["elevation_min"].value, "offset_pitch": 0.0}
    for counter, (name, rest_deg) in zip(stand, rests_deg.items(), strict=False):
        count_deg = 360.0 / rig[name.replace("offset", "encoder_counts")].value
        rest = rest_deg / count_deg
        passed = counter + rest - math.floor(counter + rest)
        zeros[name] = rig[name].value + count_deg * (round(rest) - rest + passed - 0.5)
    return zeros


def thinned(flight: Flight, every: int) -> Flight:
    """Keep one of `every` rows of a flight, with the mean of the voltages until the next kept row."""
    rows = len(flight) // every * every
    mean_V = flight.voltages_V[:rows].reshape(-1, every, 2).mean(axis=1)
    keep = slice(0, rows, every)
    return Flight(flight.t_s[keep], mean_V[:, 0], mean_V[:, 1], *flight.angles_rad[keep].T)
