"""`python -m tests.tune.monte_carlo`: the board's defaults on random rigs, as a campaign.

A quick host flies them: bytes in, bytes out, telemetry decoded when the flight is over. It has no session and
no log, and flies the flight code behind the simulated line, as any host does. It is a hundred times faster
than real time, so that a claim may be about hundreds of flights.
"""

import argparse
import copy
import functools
import os
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from heli_host import declaration as d
from heli_host.data.arrays import Floats
from heli_host.declaration import Fault
from heli_host.fly import route
from heli_host.link.channels import physical
from heli_host.link.frames import FrameParser, encode_frame
from heli_host.link.telemetry import TelemetryDecoder
from heli_lab.apps.campaign import Campaign, Case, Store, run_campaign
from heli_lab.apps.campaign.run import CampaignProgress
from heli_sim.model import MultibodyModel
from heli_sim.model.effects import RotorLag
from heli_sim.model.plant import Plant
from heli_sim.rig import Rig, load_rig
from heli_sim.rig.rig import counts_per_turn
from heli_sim.sil.options import SilOptions
from heli_sim.sil.world import SilWorld

from tests.channels.groups import COUNTS, SETPOINTS, STATUS, VOLTAGES
from tests.identify.made import hover_V

INTERVAL_TICKS = 20
LEAD_TICKS = 100
_BEFORE_TICKS = 400


@dataclass(frozen=True)
class PilotFlight:
    """A flight from the moment at which the loops closed."""

    t_s: Floats  # Time since then
    angle_deg: Floats  # Elevation, pitch and travel: measured, used by the control law, asked for
    setpoint_deg: Floats
    path_deg: Floats
    volts_V: Floats  # Front and back
    state: npt.NDArray[np.int32]  # State, fault and flags of the supervisor
    fault: npt.NDArray[np.int32]
    flags: npt.NDArray[np.int32]

    @property
    def first_fault(self) -> d.Fault:
        codes = self.fault[self.fault != 0]
        return d.Fault(int(codes[0])) if codes.size else d.Fault.NONE

    def between(self, start_s: float, stop_s: float) -> npt.NDArray[np.bool_]:
        return (self.t_s >= start_s) & (self.t_s < stop_s)


def with_numbers(plant: Plant, rig: Rig, **effects: float) -> Plant:
    """Another rig, and other numbers of its effects, for the equations that a plant has already compiled."""
    other = copy.copy(plant)
    other.rig = rig
    names = plant.model.parameter_names
    other.parameters = plant.parameters.copy()
    other.parameters[: len(names)] = plant.model.parameter_values(rig)
    for name, value in effects.items():
        other.parameters[names.index(name)] = value
    return other


def fly(
    plant: Plant,
    path_deg: Callable[[Floats], Floats],
    duration_s: float,
    parameters: Mapping[str, float] | None = None,
    seed: int = 1,
) -> PilotFlight:
    """Close all loops on the table and stream a path at 50 Hz."""
    world = SilWorld(SilOptions(seed=seed), plant)
    # Table 2 as point masses balances at -22 degrees: the arm is held down until the loops close.
    world.native.locked = [True, True, True]
    received = [world.advance(_BEFORE_TICKS)]
    sequence = request = 0

    def send(message: object) -> bytes:
        nonlocal sequence
        sequence += 1
        return encode_frame(message.ID, sequence & 0xFF, message.pack())  # type: ignore[attr-defined]

    def ask(make: Callable[[int], object]) -> None:
        nonlocal request
        request = request % 255 + 1
        received.append(world.advance(12, send(make(request))))

    ask(lambda number: d.HelloMessage(number, d.LINK_HASH, 7))
    index = {param.name: param.index for param in d.PARAMS}
    for name, value in (parameters or {}).items():
        ask(functools.partial(_param_set, index[name], value))
    ask(d.ArmMessage)
    start_tick = world.tick
    first = send(d.ControlMessage(request + 1, 7, 0.0, 0.0))
    world.native.locked = [False, False, False]
    ticks = np.arange(0, round(1e3 * duration_s), INTERVAL_TICKS)
    targets_rad = np.radians(path_deg((ticks + LEAD_TICKS).astype(np.float64) * 1e-3)).tolist()
    # The board counts its own ticks from its start, the world from its own.
    for tick, target_rad in zip(ticks.tolist(), targets_rad, strict=True):
        message = d.SetpointMessage(start_tick + tick + LEAD_TICKS, *target_rad)
        received.append(world.advance(INTERVAL_TICKS, first + send(message)))
        first = b""
    received.append(world.advance(40))
    return _decoded(b"".join(received), start_tick, path_deg, duration_s, counts_per_turn(plant.rig))


def _param_set(index: int, value: float, request: int) -> d.ParamSetMessage:
    return d.ParamSetMessage(request, index, value)


def _decoded(
    data: bytes, start_tick: int, path_deg: Callable[[Floats], Floats], duration_s: float, counts: Floats
) -> PilotFlight:
    frames = FrameParser().feed(data)
    telemetry = TelemetryDecoder().decode([f.payload for f in frames if f.id == d.MessageId.TELEMETRY])
    tick = telemetry.tick.astype(np.int64) - start_tick
    keep = (tick >= 0) & (tick < round(1e3 * duration_s))
    t_s, raw = tick[keep].astype(np.float64) * 1e-3, telemetry.raw[keep]

    def columns(group: list[d.Channel]) -> Floats:
        return np.column_stack([physical(raw, channel) for channel in group])

    return PilotFlight(
        t_s.astype(np.float64),
        np.asarray(columns(COUNTS) * 360.0 / counts, np.float64),
        np.degrees(columns(SETPOINTS)),
        path_deg(t_s.astype(np.float64)),
        columns(VOLTAGES),
        *(raw[:, channel] for channel in STATUS),
    )


TAKE_OFF_S, STEP_S, BACK_S, SINE_S, END_S = 0.0, 6.0, 14.0, 22.0, 82.0
STEP_DEG = 15.0


def demanding_path_deg(t_s: Floats) -> Floats:
    """Take-off to level, a travel step of 15 degrees and back, then the sines of the plan ``sine``."""
    out = np.zeros((t_s.size, 3))
    out[(t_s >= STEP_S) & (t_s < BACK_S), 2] = STEP_DEG
    swinging = (t_s >= SINE_S) & (t_s < END_S)
    shape = route.sine(np.zeros(3), np.array([5.0, 0.0, 25.0]), np.array([15.0, 1.0, 20.0]), END_S - SINE_S)
    out[swinging] = shape(t_s[swinging] - SINE_S)
    return out


@dataclass(frozen=True)
class FlightMetrics:
    """Promises of a flight along `demanding_path_deg`."""

    fault: d.Fault  # First fault
    take_off_s: float  # From when on the elevation stays within half a degree of level, until the step
    overshoot: float  # Overshoot as a share of the travel step; the worse of both steps
    settling_time_s: float  # From when on travel stays within half a degree of the step; the worse of both
    travel_rms_deg: float  # Error to the path over the sines
    elevation_rms_deg: float
    # Over the sines: what is left of the pitch setpoint, and of the difference of the voltages, above 2 Hz.
    pitch_setpoint_ripple_deg: float
    volts_ripple_V: float


def flight_metrics(flown: PilotFlight) -> FlightMetrics:
    elevation, travel = flown.angle_deg[:, 0], flown.angle_deg[:, 2]
    climb, there = flown.between(TAKE_OFF_S, STEP_S), flown.between(STEP_S, BACK_S)
    back, sine = flown.between(BACK_S, SINE_S), flown.between(SINE_S, END_S)
    error = flown.angle_deg - flown.path_deg
    return FlightMetrics(
        flown.first_fault,
        last_outside_s(flown.t_s[climb], elevation[climb]),
        float(max(travel[there].max() - STEP_DEG, -travel[back].min()) / STEP_DEG) if sine.any() else np.inf,
        max(
            last_outside_s(flown.t_s[there] - STEP_S, travel[there] - STEP_DEG),
            last_outside_s(flown.t_s[back] - BACK_S, travel[back]),
        ),
        rms(error[sine, 2]),
        rms(error[sine, 0]),
        ripple(flown.setpoint_deg[sine, 1]),
        ripple(flown.volts_V[sine, 0] - flown.volts_V[sine, 1]),
    )


def ripple(values: Floats) -> float:
    """Root mean square of what is left above about 2 Hz: less its mean over half a second."""
    if values.size < 1000:
        return float("inf")
    window = np.ones(500) / 500
    return rms(values[250:-249] - np.convolve(values, window, "valid"))


def rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(values**2))) if values.size else float("inf")


def last_outside_s(t_s: Floats, error_deg: Floats, band_deg: float = 0.5) -> float:
    """When the error was last outside the band; 0 if never, infinite if it still is at the end."""
    outside = np.flatnonzero(np.abs(error_deg) > band_deg)
    if t_s.size == 0 or (outside.size and outside[-1] >= t_s.size - 2):
        return float("inf")
    return float(t_s[outside[-1] + 1]) if outside.size else 0.0


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
    # The board has the hover voltage of each rig, as the fault elevation_motionless asks: with that of the
    # nominal rig, it lands 9 of 200.
    faults, tilt_deg = {}, 0.0
    for seed in seeds:
        rig, lag_s = random_rig(seed)
        plant = with_numbers(lagging_plant(), rig, rotor_lag_s=lag_s)
        own_parameters = {"hover_V": hover_V(rig), **parameters}
        end = fly(plant, demanding_path_deg, duration_s, own_parameters, seed=seed)
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
