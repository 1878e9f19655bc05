"""Draw a design: simulated flights on the left, Nyquist curves of all loops and plants on the right."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from heli_host.data.flight import Flight
from heli_sim.model.parts import AXES
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from heli_lab.control.tune.design import Design
from heli_lab.control.tune.loops import LOOPS, open_loops

_SETPOINT_COLOUR, _CORNER_COLOUR = "#222222", "#cccccc"
_COLOURS: Final = ("#0b5fa5", "#d1495b", "#2a9d55", "#8a5fbf")
_AXIS_LIMIT: Final = 2.2
_FONT_SIZE: Final = 8


def figure_of_design(design: Design, flights: Sequence[tuple[str, Flight]]) -> Figure:
    """Draw a design and flights with its gains."""
    figure = Figure(figsize=(14, 7.2), layout="constrained")
    grid = figure.add_gridspec(4, 4, width_ratios=[1.0, 1.0, 1.1, 1.1])
    first = figure.add_subplot(grid[0, :2])
    panels = [first, *(figure.add_subplot(grid[row, :2], sharex=first) for row in range(1, 4))]
    _draw_flights(panels, flights)
    for number, loop in enumerate(LOOPS):
        row, column = 2 * (number // 2), 2 + number % 2
        axes = figure.add_subplot(grid[row : row + 2, column])
        _draw_loop(axes, loop, design)
        if number == 0:
            axes.legend(loc="lower right", fontsize=_FONT_SIZE)
            text = f"red: disturbances are amplified\nmore than {design.sensitivity:g} times"
            axes.text(-_AXIS_LIMIT + 0.1, 0.9, text, fontsize=_FONT_SIZE, va="top")
    return figure


def _draw_flights(panels: Sequence[Axes], flights: Sequence[tuple[str, Flight]]) -> None:
    """Draw angles with their setpoints, and the front motor's voltage, over time."""
    for (label, flight), colour in zip(flights, _COLOURS, strict=False):
        angles_deg = np.rad2deg(flight.angles_rad)
        for index, axes in enumerate(panels[:3]):
            axes.plot(flight.t_s, angles_deg[:, index], color=colour, lw=0.9, label=label)
        panels[3].plot(flight.t_s, flight.front_V, color=colour, lw=0.5)
    _, first = flights[0]
    setpoints = (first.elevation_setpoint_rad, None, first.travel_setpoint_rad)
    for index, setpoint_rad in enumerate(setpoints):
        if setpoint_rad is not None:
            label = "setpoint"
            panels[index].plot(
                first.t_s, np.rad2deg(setpoint_rad), color=_SETPOINT_COLOUR, lw=0.9, ls="--", label=label
            )
        panels[index].set_ylabel(f"{AXES[index]} [deg]")
    panels[3].set_ylabel("front motor [V]")
    panels[3].set_xlabel("time since take-off [s]")
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
