"""Fly healthy rigs and rigs with a wrong encoder, and count warnings: ``python -m tests.fly.encoder_scale``.

The rigs are drawn within the tolerances of makki2024, half of them with a lag of their rotors that its file
does not state, under disturbances of three strengths. The judge uses the nominal rig. Further flights of the
nominal rig hide an effect of the catalogue or a wrong supply: their encoders are right.
"""

import argparse
import math
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from heli_host.board.heli import Heli
from heli_host.data.flight import Flight
from heli_host.data.log.reader import read_flight
from heli_host.errors import HeliError
from heli_host.fly.plan import plan_names
from heli_host.fly.runner import fly
from heli_host.link.session import Session
from heli_lab.control.tune.design import find_gains
from heli_lab.watch.encoder_scale import (
    MAX_SIGMAS,
    ScaleEstimate,
    ScaleTest,
    finding_of,
    possible_effects,
    wrong_scale,
)
from heli_lab.watch.learn import with_process_noise
from heli_lab.watch.weak_form import FlightInWeakForm
from heli_sim.model import MultibodyModel, model_named
from heli_sim.model.base import Model
from heli_sim.model.effect import AXES
from heli_sim.model.effects import catalogue, effects_of
from heli_sim.model.linear import trim
from heli_sim.model.plant import Plant
from heli_sim.rig import Rig, load_rig, rig_names
from heli_sim.sil.faults import RigFaults
from heli_sim.sil.inprocess import InProcessTransport
from heli_sim.sil.options import SilOptions
from heli_sim.sil.world import SilWorld

from tests.twin.rigs import true_rig

NOMINAL: Final = "makki2024"
SCALES: Final = (0.5, 0.7, 0.9, 0.99, 1.1, 1.4, 2.0)
HEALTHY_FROM: Final = 301
WRONG_FROM: Final = 501
"""First seeds of the rigs; the estimator was set on the seeds 1 to 230."""
HIDDEN_SEED: Final = 701
WRONG_SUPPLY_V: Final = (15.0, 18.0, 24.0)
"""Supplies that the board assumes; it has 12 V. Below 12 V, the board does not arm."""


@dataclass(frozen=True)
class Flown:
    """A flight: its outcome, the estimates, the axis of the warning, and what the warning blames."""

    # `warned`: Scale that differs from 1; None without a warning.
    # `names_encoder`: Whether the warning names the encoder; otherwise, something else explains the flight as
    # well.

    outcome: str
    estimates: tuple[ScaleEstimate, ...]
    warned: ScaleEstimate | None
    names_encoder: bool


def judge(outcome: str, flight: Flight, rig: Rig, model: Model) -> Flown:
    """Check a flight as `heli-host fly` does."""
    test = ScaleTest(FlightInWeakForm(flight, rig, model))
    warned = wrong_scale(test.estimates)
    names_encoder = False
    if warned is not None:
        finding = finding_of(warned, test.explanations(possible_effects(model)))
        names_encoder = finding.name == f"{warned.axis}_encoder_scale"
    return Flown(outcome, test.estimates, warned, names_encoder)


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
    return judge(outcome, flight, load_rig(NOMINAL), MultibodyModel())


def distance_from_one(estimate: ScaleEstimate) -> float:
    """Distance of a scale from 1, in standard errors, or by its likelihood if that is less."""
    # A scale near 0 has a small error, and is not more likely than 1.
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
        distances, standard_errors = [], []
        for place, axis in enumerate(AXES):
            of_axis = [flight.estimates[place] for flight in with_estimates]
            largest_distance = max(map(distance_from_one, of_axis), default=0.0)
            errors = [estimate.standard_error for estimate in of_axis]
            error = float(np.median(errors)) if errors else np.nan
            shown = f"{error:.3f}" if np.isfinite(error) else "not visible"
            distances.append(f"{axis} {largest_distance:.1f}")
            standard_errors.append(f"{axis} {shown}")
        lines.append(
            f"| {plan} | {len(flown)} | {warned} | {', '.join(distances)} | {', '.join(standard_errors)} |"
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
                warned = [flight.warned.axis if flight.warned else "" for flight in flown]
                named = [axis_ for flight, axis_ in zip(flown, warned, strict=True) if flight.names_encoder]
                common = sum(map(bool, warned)) - len(named)
                other = sum(other_axis != axis for other_axis in named)
                faults = sum("fault" in flight.outcome for flight in flown)
                cells.append(
                    f"{named.count(axis)}/{len(flown)}"
                    + (f", {common} common" if common else "")
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
                    flown.append(judge(outcome, flight, rig, model))
        warned = sum(judged_flight.warned is not None for judged_flight in flown)
        estimates_of_rig = [estimate for judged_flight in flown for estimate in judged_flight.estimates]
        most = max(map(distance_from_one, estimates_of_rig), default=0.0)
        lines.append(
            f"{name}: {len(flown)} flights, {warned} warnings, at most {most:.1f} standard errors from 1"
        )
        print(lines[-1], flush=True)
    return lines


def hidden_lines(plans: Sequence[str] = ("sine", "identify")) -> list[str]:
    """Warnings on flights of the nominal rig with right encoders, and an effect or a wrong supply."""
    rig, model = load_rig(NOMINAL), MultibodyModel()
    no_parameters: dict[str, float] = {}
    # Models and parameters of the flights, by name; the check does not know them.
    hidden: dict[str, tuple[Model, dict[str, float]]] = {
        kind.id: (MultibodyModel((kind.make(kind.typical),)), no_parameters)
        for kind in catalogue().values()
        if kind.suits(model) and not kind.baseline and not kind.noise_inputs
    }
    hidden |= {f"supply_V {volts:g}": (model, {"supply_V": volts}) for volts in WRONG_SUPPLY_V}
    lines = []
    for plan in plans:
        flights: dict[str, Flown] = {}
        for name, (flown_model, parameters) in hidden.items():
            outcome, flight = fly_one(flown_model, rig, plan, SilOptions(seed=HIDDEN_SEED), parameters)
            flights[name] = judge(outcome, flight, rig, model)
        warned = [name for name, flown in flights.items() if flown.warned is not None]
        accused = [name for name, flown in flights.items() if flown.names_encoder]
        lines.append(
            f"| {plan} | {len(flights)} | {len(accused)} {' '.join(accused)}| {len(warned) - len(accused)}: "
            f"{', '.join(name for name in warned if name not in accused)} |"
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
    parser.add_argument("--hidden", nargs="*", metavar="PLAN", help="only flights with hidden effects")
    options = parser.parse_args()
    if options.hidden is not None:
        print("| plan | flights | an encoder is named | something in common is named |")
        hidden_lines(options.hidden or ("sine", "identify"))
        return
    print(f"a warning needs {MAX_SIGMAS:g} standard errors; healthy flights:")
    healthy_lines(options.healthy)
    other_lines(options.others)
    print("flights with one wrong encoder, by its scale: warnings that name it, of how many:")
    wrong_lines(options.wrong)


if __name__ == "__main__":
    main()
