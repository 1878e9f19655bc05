"""Fly a test of gains in simulation: take-off, a travel step and back, sines on elevation and travel."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from heli_host.data.flight import Flight
from heli_host.declaration import State
from heli_host.fly.plan import Plan, take_off
from heli_host.fly.runner import Progress
from heli_sim.plant import Plant

from heli_lab.control.tune.flight_metrics import FlightMetrics, Phases, flight_metrics
from heli_lab.simulated_board import connected, fly_and_read, world_of

PLAN: Final = """
title = "Take-off, a step of travel and back, sines"
[start]
elevation_deg = 0
rate_deg_s = 15
settle_s = 12
[[segment]]
kind = "step"
travel_deg = 15
duration_s = 8
[[segment]]
kind = "step"
travel_deg = 0
duration_s = 8
[[segment]]
kind = "sine"
elevation_amplitude_deg = 5
elevation_period_s = 15
travel_amplitude_deg = 25
travel_period_s = 20
duration_s = 60
"""
_STEP_S, _SINE_S = 8.0, 60.0
"""Durations in `PLAN` of each step and of the sines [s]."""


@dataclass(frozen=True)
class Trial:
    """Test flight with a set of gains."""

    label: str  # Short description of the simulated rig, such as ``lag 120 ms``
    flight: Flight  # The flight in closed loop; time 0 is its beginning
    metrics: FlightMetrics  # Overshoot, settling time and tracking errors


def try_gains(
    plant: Plant,
    parameters: Mapping[str, float],
    label: str,
    seed: int = 1,
    on_progress: Callable[[float], None] | None = None,
) -> Trial:
    """Fly a set of parameters on a simulated rig, with the flight code and the link.

    A flight that ends with a fault also gives a trial; its metrics state the fault as outcome.
    """
    plan = Plan.parse(PLAN, "plan of the trial", "trial")
    length_s = plan.duration_s + plan.start.settle_s

    def report(progress: Progress) -> None:
        """Pass on the completed share of the flight."""
        if on_progress is not None:
            on_progress(min(1.0, progress.t_s / length_s))

    with connected(world_of(plant, seed)) as heli:
        heli.params.restore(parameters)
        heli.wait(0.2)
        sample = heli.latest
        start_deg = np.array([sample.elevation_deg, sample.pitch_deg, sample.travel_deg])
        route = take_off([plan], dict(heli.params), start_deg)
        flight, summary = fly_and_read(heli, plan, report)
    closed_loop_rows = np.flatnonzero(flight.state == State.CLOSED_LOOP)
    start_s = float(flight.t_s[closed_loop_rows[0]]) if closed_loop_rows.size else float(flight.t_s[0])
    stop_s = float(flight.t_s[closed_loop_rows[-1]]) if closed_loop_rows.size else start_s
    step_s = start_s + route.duration_s - plan.duration_s
    phases = Phases(
        take_off_s=start_s,
        step_s=step_s,
        back_s=step_s + _STEP_S,
        sine_s=step_s + 2 * _STEP_S,
        end_s=step_s + 2 * _STEP_S + _SINE_S,
    )
    in_closed_loop = flight.between(start_s, stop_s)
    metrics = flight_metrics(
        in_closed_loop, lambda t_s: route.evaluate(t_s - start_s), phases, summary.outcome
    )
    return Trial(label, replace(in_closed_loop, t_s=in_closed_loop.t_s - start_s), metrics)
