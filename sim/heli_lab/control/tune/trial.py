"""Fly a test of gains in simulation, measure it and draw it: take-off, a travel step and back, sines.

Overshoot and settling time are those of `heli_host.data.response`, relative to the planned path.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from heli_host.data.arrays import Booleans, Floats
from heli_host.data.flight import Flight
from heli_host.data.response import count_rad, rms, step_metrics
from heli_host.declaration import State
from heli_host.fly.plan import Plan, take_off
from heli_host.fly.runner import Progress
from heli_sim.model.effect import AXES
from heli_sim.model.plant import Plant
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from heli_lab.control.tune.design import TRAVEL_STEP_DEG, Design
from heli_lab.control.tune.loops import LOOPS, open_loops
from heli_lab.simulated_board import WITHOUT_TRAVEL_CHECKS, connected, fly_and_read, world_of

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
    """Fly a set of parameters on a simulated rig, with the flight code and the link."""
    # A flight that ends with a fault also gives a trial; its metrics state the fault as outcome.
    plan = Plan.parse(PLAN, "plan of the trial", "trial")
    length_s = plan.duration_s + plan.start.settle_s

    def report(progress: Progress) -> None:
        """Pass on the completed share of the flight."""
        if on_progress is not None:
            on_progress(min(1.0, progress.t_s / length_s))

    with connected(world_of(plant, seed)) as heli:
        heli.params.restore({**parameters, **WITHOUT_TRAVEL_CHECKS})
        heli.wait(0.2)  # Seconds until a sample has arrived
        sample = heli.latest
        start_deg = np.array([sample.elevation_deg, sample.pitch_deg, sample.travel_deg])
        route = take_off([plan], dict(heli.params), start_deg)
        flight, summary = fly_and_read(heli, plan, report)
    # If a fault ended the flight before the take-off, it has no rows in closed loop.
    closed_loop_s = flight.t_s[flight.state == State.CLOSED_LOOP]
    start_s = float(closed_loop_s[0]) if closed_loop_s.size else float(flight.t_s[0])
    stop_s = float(closed_loop_s[-1]) if closed_loop_s.size else start_s
    # The route is the take-off, then the plan, which begins with the step.
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


@dataclass(frozen=True)
class Phases:
    """Times of the phases of a test flight, on the flight's time axis [s]."""

    take_off_s: float
    """take_off_s, step_s, back_s, sine_s, end_s: Beginning of the take-off, of the travel step, of the step
    back and of the sines; end of the sines."""
    step_s: float
    back_s: float
    sine_s: float
    end_s: float


@dataclass(frozen=True)
class FlightMetrics:
    """Performance of a set of gains in a test flight."""

    outcome: str  # ``completed``, or the reason why the flight ended
    take_off_s: float  # Settling time of the take-off; infinite if it never settles
    overshoot_percent: float  # Overshoot of the travel step, the larger one of both directions
    settling_time_s: float
    """Settling time of the travel step, the longer one of both directions; infinite if it never settles."""
    travel_rms_deg: float  # travel_rms_deg, elevation_rms_deg: RMS tracking error along the sines
    elevation_rms_deg: float
    pitch_max_deg: float  # Largest absolute pitch


def flight_metrics(
    flight: Flight, path_deg: Callable[[Floats], Floats], phases: Phases, outcome: str
) -> FlightMetrics:
    """Measure a test flight; metrics of phases that it did not reach are infinite."""
    t_s, angles_deg = flight.t_s, np.rad2deg(flight.angles_rad)
    elevation, pitch, travel = angles_deg.T
    in_take_off = _rows_between(t_s, phases.take_off_s, phases.step_s)
    in_step = _rows_between(t_s, phases.step_s, phases.back_s)
    in_step_back = _rows_between(t_s, phases.back_s, phases.sine_s)
    in_sines = _rows_between(t_s, phases.sine_s, phases.end_s)
    elevation_error_deg, _, travel_error_deg = (angles_deg[in_sines] - path_deg(t_s[in_sines])).T
    elevation_count_deg, _, travel_count_deg = np.rad2deg(count_rad(flight)).tolist()
    steps = [
        step_metrics(
            t_s[rows] - begin_s,
            travel[rows],
            start_deg=start_deg,
            end_deg=end_deg,
            count_deg=travel_count_deg,
        )
        for rows, begin_s, start_deg, end_deg in (
            # Rows, begin, and setpoints before and after the step.
            (in_step, phases.step_s, 0.0, TRAVEL_STEP_DEG),
            (in_step_back, phases.back_s, TRAVEL_STEP_DEG, 0.0),
        )
    ]
    take_off = step_metrics(
        t_s[in_take_off] - phases.take_off_s,
        elevation[in_take_off],
        start_deg=float(elevation[in_take_off][0]) if in_take_off.any() else 0.0,
        end_deg=0.0,
        count_deg=elevation_count_deg,
    )
    return FlightMetrics(
        outcome=outcome,
        take_off_s=_nan_to_infinite(take_off.settling_s),
        overshoot_percent=max(_nan_to_infinite(metrics.overshoot_percent) for metrics in steps),
        settling_time_s=max(_nan_to_infinite(metrics.settling_s) for metrics in steps),
        travel_rms_deg=_nan_to_infinite(rms(travel_error_deg)),
        elevation_rms_deg=_nan_to_infinite(rms(elevation_error_deg)),
        pitch_max_deg=float(np.abs(pitch).max(initial=0.0)),
    )


def _rows_between(t_s: Floats, start_s: float, stop_s: float) -> Booleans:
    """Select the rows whose times `t_s`, shape (n,), are from `start_s` to before `stop_s`."""
    return (t_s >= start_s) & (t_s < stop_s)


def _nan_to_infinite(value: float) -> float:
    """Return infinity for nan, which stands for a result that was not reached."""
    return math.inf if math.isnan(value) else value


_SETPOINT_COLOUR, _CORNER_COLOUR = "#222222", "#cccccc"
_COLOURS: Final = ("#0b5fa5", "#d1495b", "#2a9d55", "#8a5fbf")
_AXIS_LIMIT: Final = 2.2
_FONT_SIZE: Final = 8


def figure_of_design(design: Design, trials: Sequence[Trial]) -> Figure:
    """Draw a design and the test flights with its gains."""
    figure = Figure(figsize=(14, 7.2), layout="constrained")
    grid = figure.add_gridspec(4, 4, width_ratios=[1.0, 1.0, 1.1, 1.1])
    first = figure.add_subplot(grid[0, :2])
    panels = [first, *(figure.add_subplot(grid[row, :2], sharex=first) for row in range(1, 4))]
    _draw_flights(panels, trials)
    for number, loop in enumerate(LOOPS):
        row, column = 2 * (number // 2), 2 + number % 2
        axes = figure.add_subplot(grid[row : row + 2, column])
        _draw_loop(axes, loop, design)
        if number == 0:
            axes.legend(loc="lower right", fontsize=_FONT_SIZE)
            text = f"red: disturbances are amplified\nmore than {design.sensitivity:g} times"
            axes.text(-_AXIS_LIMIT + 0.1, 0.9, text, fontsize=_FONT_SIZE, va="top")
    return figure


def _draw_flights(panels: Sequence[Axes], trials: Sequence[Trial]) -> None:
    """Draw angles with their setpoints, and the front motor's voltage, over time."""
    *angle_panels, voltage_panel = panels
    for trial, colour in zip(trials, _COLOURS, strict=False):  # There may be more colours than trials
        flight = trial.flight
        angles_deg = np.rad2deg(flight.angles_rad)
        for index, axes in enumerate(angle_panels):
            axes.plot(flight.t_s, angles_deg[:, index], color=colour, lw=0.9, label=trial.label)
        voltage_panel.plot(flight.t_s, flight.front_V, color=colour, lw=0.5)
    # All flights follow the same setpoints.
    first = trials[0].flight
    setpoints = (
        first.elevation_setpoint_rad,
        None,  # of pitch: the travel loop computes another one in each flight
        first.travel_setpoint_rad,
    )
    for axes, axis, setpoint_rad in zip(angle_panels, AXES, setpoints, strict=True):
        if setpoint_rad is not None:
            setpoint_deg = np.rad2deg(setpoint_rad)
            axes.plot(first.t_s, setpoint_deg, color=_SETPOINT_COLOUR, lw=0.9, ls="--", label="setpoint")
        axes.set_ylabel(f"{axis} [deg]")
    voltage_panel.set_ylabel("front motor [V]")
    voltage_panel.set_xlabel("time since take-off [s]")
    panels[0].legend(loc="lower right", fontsize=_FONT_SIZE)
    panels[0].set_title("Simulated flights with the flight code", loc="left", fontsize=10)
    for axes in panels:
        axes.grid(alpha=0.25)


def _draw_loop(axes: Axes, loop: str, design: Design) -> None:
    """Draw the Nyquist curves of a `loop` on all plants, and the disc around -1 that the bound on the
    sensitivity excludes.
    """
    frequency = np.geomspace(0.05, 200.0, 600)
    nominal = [plant for plant in design.plants if plant.thrust == plant.counterweight == 1.0]
    for plant in design.plants:
        gain = open_loops(plant, design.law, frequency)[loop]
        if plant in nominal:
            colour = _COLOURS[nominal.index(plant) % len(_COLOURS)]
            axes.plot(
                gain.real, gain.imag, color=colour, lw=1.2, zorder=3, label=f"lag {1e3 * plant.lag_s:.0f} ms"
            )
        else:
            axes.plot(gain.real, gain.imag, color=_CORNER_COLOUR, lw=0.7, zorder=1)
    angle = np.linspace(0.0, 2.0 * np.pi, 100)
    radius = 1.0 / design.sensitivity
    axes.fill(-1.0 + radius * np.cos(angle), radius * np.sin(angle), color="#f4b6ae", zorder=2)
    axes.plot(-1.0, 0.0, "+", color=_SETPOINT_COLOUR, zorder=4)
    axes.set(xlim=(-_AXIS_LIMIT, 1.0), ylim=(-_AXIS_LIMIT, 1.0), aspect="equal")
    axes.set_title(f"{loop} loop", loc="left", fontsize=10)
    axes.grid(alpha=0.25)
    axes.tick_params(labelsize=_FONT_SIZE)
