"""Fly healthy rigs and rigs with a wrong encoder, and count warnings: ``python -m tests.fly.encoder_scale``.

The rigs are drawn within the tolerances of makki2024, half of them with a lag of their rotors that its file
does not state, under disturbances of three strengths. The judge uses the nominal rig.
"""

from __future__ import annotations

import argparse
import math
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from heli_host.errors import HeliError
from heli_host.flight import Flight
from heli_host.fly.plan import plan_names
from heli_host.fly.runner import fly
from heli_host.heli import Heli
from heli_host.link.session import Session
from heli_host.log.flight_file import read_flight
from heli_lab.encoder_scale.estimate import ScaleEstimate, scales_of
from heli_lab.encoder_scale.warning import MAX_SIGMAS, wrong_scale
from heli_lab.tune.design import find_gains
from heli_lab.twin.healthy_flights import with_process_noise
from heli_sim.model import MultibodyModel
from heli_sim.model.base import Model
from heli_sim.model.effects import effects_of
from heli_sim.model.linear import trim
from heli_sim.model.named import model_named
from heli_sim.model.parts import AXES
from heli_sim.plant import Plant
from heli_sim.rig import Rig, load_rig, rig_names
from heli_sim.sil.inprocess import InProcessTransport
from heli_sim.sil.options import SilOptions
from heli_sim.sil.rig_faults import RigFaults
from heli_sim.sil.world import SilWorld

from tests.twin.rigs import true_rig

NOMINAL: Final = "makki2024"
SCALES: Final = (0.5, 0.7, 0.9, 0.99, 1.1, 1.4, 2.0)
HEALTHY_FROM: Final = 301
WRONG_FROM: Final = 501
"""First seeds of the rigs; the estimator was set on the seeds 1 to 230."""


@dataclass(frozen=True)
class Flown:
    """A flight of a drawn rig: its outcome, the estimates, and the axis that the warning names."""

    outcome: str
    estimates: tuple[ScaleEstimate, ...]
    warned: ScaleEstimate | None


def fly_drawn(plan: str, seed: int, axis: int = 0, scale: float = 1.0) -> tuple[str, Flight]:
    """Fly a shipped plan on the rig of a seed, one of its encoders with a wrong scale."""
    drawn = true_rig(seed)
    scales = [1.0, 1.0, 1.0]
    scales[axis] = scale
    faults = RigFaults(encoder_scales=(scales[0], scales[1], scales[2]))
    # Settings of the operator of this rig.
    hover_V = float(sum(trim(MultibodyModel(), drawn.rig).volts_V)) - 2.0 * drawn.rig["dead_zone"].value
    options = SilOptions(seed=seed, rig_faults=faults)
    return fly_one(drawn.disturbed_model, drawn.rig, plan, options, {"hover_V": hover_V})


def fly_one(
    model: Model, rig: Rig, plan: str, options: SilOptions, parameters: Mapping[str, float]
) -> tuple[str, Flight]:
    """Fly a shipped plan on a rig with parameters of the board; returns the outcome and the flight."""
    world = SilWorld(options, Plant(model, rig, options.seed))
    session = Session(InProcessTransport(world), session_number=1)
    session.connect()
    with tempfile.TemporaryDirectory() as folder, Heli(session) as heli:
        heli.params.restore({**parameters, "arm_elevation_tolerance_deg": 20.0})
        path = Path(folder) / "flight.mcap"
        summary = fly(heli, plan, log_path=path)
        return summary.outcome, read_flight(path)


def judged(plan: str, seed: int, axis: int = 0, scale: float = 1.0) -> Flown | None:
    """What is said of such a flight; None where gusts moved the arm so much that it did not arm."""
    try:
        outcome, flight = fly_drawn(plan, seed, axis, scale)
    except HeliError:
        return None
    if not np.any(flight.voltages_V):
        return None
    estimates = scales_of(flight, load_rig(NOMINAL), MultibodyModel())
    return Flown(outcome, estimates, wrong_scale(estimates))


def distance_from_one(estimate: ScaleEstimate) -> float:
    """Distance of a scale from 1, in standard errors, or by its likelihood if that is less.

    A scale near 0 has a small error, and is not more likely than 1.
    """
    return min(estimate.sigmas, math.sqrt(2.0 * max(estimate.nats, 0.0)))


def healthy_lines(rigs: int) -> list[str]:
    """Warnings on healthy flights, by plan, and how far the estimates are from 1 in standard errors."""
    lines = [
        "| plan | flights | warnings | largest distance from 1, standard errors | median standard error |"
    ]
    lines.append("|---|---|---|---|---|")
    for plan in plan_names():
        flown = [
            flight for seed in range(HEALTHY_FROM, HEALTHY_FROM + rigs) if (flight := judged(plan, seed))
        ]
        warned = sum(flight.warned is not None for flight in flown)
        with_estimates = [flight for flight in flown if flight.estimates]
        cells = []
        for place, axis in enumerate(AXES):
            of_axis = [flight.estimates[place] for flight in with_estimates]
            most = max(map(distance_from_one, of_axis), default=0.0)
            errors = [estimate.standard_error for estimate in of_axis]
            error = float(np.median(errors)) if errors else np.nan
            shown = f"{error:.3f}" if np.isfinite(error) else "not visible"
            cells.append((f"{axis} {most:.1f}", f"{axis} {shown}"))
        lines.append(
            f"| {plan} | {len(flown)} | {warned} | {', '.join(a for a, _ in cells)} "
            f"| {', '.join(b for _, b in cells)} |"
        )
        print(lines[-1], flush=True)
    return lines


def wrong_lines(rigs: int) -> list[str]:
    """Warnings on flights with one wrong encoder: how many name it, how many another one."""
    lines = [f"| plan | axis | {' | '.join(map(str, SCALES))} |", "|---" * (2 + len(SCALES)) + "|"]
    for plan in plan_names():
        for place, axis in enumerate(AXES):
            cells = []
            for scale in SCALES:
                flown = [
                    flight
                    for seed in range(WRONG_FROM, WRONG_FROM + rigs)
                    if (flight := judged(plan, seed, place, scale))
                ]
                named = sum(flight.warned is not None and flight.warned.axis == axis for flight in flown)
                other = sum(flight.warned is not None and flight.warned.axis != axis for flight in flown)
                faults = sum("fault" in flight.outcome for flight in flown)
                cells.append(
                    f"{named}/{len(flown)}"
                    + (f", {other} other" if other else "")
                    + (f", {faults} faults" if faults else "")
                )
            lines.append(f"| {plan} | {axis} | {' | '.join(cells)} |")
            print(lines[-1], flush=True)
    return lines


def other_lines(flights: int) -> list[str]:
    """The same on the other shipped rigs as their files have them, tuned and under disturbances."""
    lines = []
    for name in rig_names():
        if name == NOMINAL:
            continue
        rig = load_rig(name)
        model = model_named(rig.model or MultibodyModel.name, effects_of(rig))
        negative_text = find_gains(rig).parameters
        flown = []
        for plan in plan_names():
            for seed in range(HEALTHY_FROM, HEALTHY_FROM + flights):
                disturbed_model = with_process_noise(model, true_rig(seed).disturbances)
                outcome, flight = fly_one(disturbed_model, rig, plan, SilOptions(seed=seed), negative_text)
                if np.any(flight.voltages_V):
                    estimates = scales_of(flight, rig, model)
                    flown.append(Flown(outcome, estimates, wrong_scale(estimates)))
        warned = sum(judged_flight.warned is not None for judged_flight in flown)
        estimates_of_rig = [estimate for judged_flight in flown for estimate in judged_flight.estimates]
        most = max(map(distance_from_one, estimates_of_rig), default=0.0)
        lines.append(
            f"{name}: {len(flown)} flights, {warned} warnings, at most {most:.1f} standard errors from 1"
        )
        print(lines[-1], flush=True)
    return lines


def main() -> None:
    """Read options, fly, print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--healthy", type=int, default=30, help="healthy flights of each shipped plan")
    parser.add_argument(
        "--others", type=int, default=3, help="flights of each plan on each other shipped rig"
    )
    parser.add_argument("--wrong", type=int, default=3, help="flights of each plan, axis and scale")
    options = parser.parse_args()
    print(f"a warning needs {MAX_SIGMAS:g} standard errors; healthy flights:")
    healthy_lines(options.healthy)
    other_lines(options.others)
    print("flights with one wrong encoder, by its scale: warnings that name it, of how many:")
    wrong_lines(options.wrong)


if __name__ == "__main__":
    main()
