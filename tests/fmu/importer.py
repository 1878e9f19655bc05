"""A flight of an FMU as an importer makes it, by co-simulation or by model exchange, and the plant's own."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
from heli_host.data.arrays import Floats
from heli_sim.compiled import compile_function
from heli_sim.plant import Plant

OUTPUTS = [3, 4, 5]
STEP_S = 1e-3


def voltages(seconds: float, hover_V: Floats) -> Floats:
    """Front and back voltage of each millisecond, shape (n, 2): a second of rest, then hover and sines."""
    t_s = np.arange(round(seconds / STEP_S)) * STEP_S
    both = 0.12 * np.sin(2.0 * np.pi * 0.13 * t_s) + 0.05 * np.sin(2.0 * np.pi * 0.7 * t_s)
    apart = 0.06 * np.sin(2.0 * np.pi * 0.31 * t_s)
    volts = hover_V + np.column_stack((both + apart, both - apart))
    return np.where(t_s[:, None] < 1.0, 0.0, volts)


def plants_flight(plant: Plant, volts_V: Floats) -> Floats:
    """Measured angles at the end of each millisecond, shape (n, 3), by the simulation's own compiled step."""
    library = compile_function(plant.function)
    assert library is not None
    step = ca.external(plant.function.name(), str(library))
    run = step.mapaccum("flight", len(volts_V))
    count = len(volts_V)
    _, measured = run(
        plant.rest_state(), volts_V.T, np.zeros((3, count)), np.tile(plant.parameters[:, None], count)
    )
    return np.asarray(measured).T


def instance_in_initialization(path: Path, folder: Path, *, co_simulation: bool) -> Any:
    """An instance of the FMU, in initialization mode."""
    import fmpy
    from fmpy.fmi3 import FMU3Model, FMU3Slave

    description = fmpy.read_model_description(str(path))
    unpacked = fmpy.extract(str(path), str(folder))
    interface = description.coSimulation if co_simulation else description.modelExchange
    made = (FMU3Slave if co_simulation else FMU3Model)(
        guid=description.guid,
        unzipDirectory=unpacked,
        modelIdentifier=interface.modelIdentifier,
        instanceName="rig",
    )
    made.instantiate()
    made.enterInitializationMode(startTime=0.0)
    return made


def co_simulated(path: Path, folder: Path, volts_V: Floats, ticks: int = 1) -> Floats:
    """Measured angles after each communication step of so many milliseconds."""
    slave = instance_in_initialization(path, folder, co_simulation=True)
    slave.exitInitializationMode()
    matches = []
    for row in range(0, len(volts_V), ticks):
        slave.setFloat64([1, 2], volts_V[row].tolist())
        slave.doStep(row * STEP_S, ticks * STEP_S)
        matches.append(slave.getFloat64(OUTPUTS))
    slave.terminate()
    slave.freeInstance()
    return np.array(matches)


def exchanged(path: Path, folder: Path, volts_V: Floats, states: int) -> tuple[Floats, int]:
    """Measured angles at the end of each millisecond, integrated by Runge and Kutta's fourth order here, and
    how many events there were.
    """
    from ctypes import c_double

    model = instance_in_initialization(path, folder, co_simulation=False)
    model.setFloat64([1, 2], volts_V[0].tolist())
    model.exitInitializationMode()
    buffer, rates = (c_double * states)(), (c_double * states)()
    indicators = (c_double * 6)()

    def rate(x: Floats, at_s: float) -> Floats:
        model.setTime(at_s)
        buffer[:] = x.tolist()
        model.setContinuousStates(buffer, states)
        model.getContinuousStateDerivatives(rates, states)
        return np.array(rates[:])

    def event() -> float:
        _, _, _, _, due, next_s = model.updateDiscreteStates()
        model.enterContinuousTimeMode()
        model.getContinuousStates(buffer, states)
        return float(next_s) if due else np.inf

    next_s, events = event(), 1
    matches = []
    for row in range(len(volts_V)):
        at_s, h = row * STEP_S, STEP_S
        x = np.array(buffer[:])
        k1 = rate(x, at_s)
        k2 = rate(x + h / 2 * k1, at_s + h / 2)
        k3 = rate(x + h / 2 * k2, at_s + h / 2)
        k4 = rate(x + h * k3, at_s + h)
        x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        model.setTime(at_s + h)
        buffer[:] = x.tolist()
        model.setContinuousStates(buffer, states)
        # The voltages that act from here on are there before the event, as an importer has it.
        model.setFloat64([1, 2], volts_V[min(row + 1, len(volts_V) - 1)].tolist())
        model.getEventIndicators(indicators, 6)
        if next_s <= at_s + h + 1e-9 or min(indicators[:]) <= 0.0:
            model.enterEventMode()
            next_s, events = event(), events + 1
        matches.append(model.getFloat64(OUTPUTS))
    model.terminate()
    model.freeInstance()
    return np.array(matches), events
