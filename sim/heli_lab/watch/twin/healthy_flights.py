"""Simulates nominal flights of a model with its disturbances, from which the alarm threshold is set."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from heli_host.data.flight import Flight
from heli_host.errors import FlightAborted
from heli_host.fly.plan import Plan
from heli_sim.model.base import Effect, Model
from heli_sim.model.effects import catalogue
from heli_sim.model.parts import AXES
from heli_sim.plant import Plant
from heli_sim.rig import Rig
from heli_sim.rig.quantity import Quantity

from heli_lab.fit.flight_model import TORQUE_STD_Nm
from heli_lab.fit.grey_box import DisturbanceModel, SLOW_CORRELATION_TIME_s
from heli_lab.simulated_board import connected, fly_and_read, set_hover, world_of

_TORQUE_SHARE: Final = 0.5
"""Standard deviation of the constant torques of simulated flights as a share of `TORQUE_STD_Nm`: the torques
of an identified rig are better known than their prior."""

_TIME_RANGE_s: Final = (0.02, 20.0)
"""Shortest and longest correlation time of gusts that the simulation accepts [s]."""
_OTHER_SEGMENTS_s: Final = 28.0
"""Duration of a random plan without its sines [s]: take-off, settling, waypoints and hover."""
_MIN_SINES_s: Final = 17.0
"""Shortest duration of the sines [s]: a period of the fastest travel."""
_PLAN: Final = """
title = "Healthy {seed}"
[start]
elevation_deg = 0
rate_deg_s = 8
settle_s = 3
[[segment]]
kind = "sine"
travel_amplitude_deg = {travel}
travel_period_s = {travel_s}
elevation_amplitude_deg = {elevation}
elevation_period_s = {elevation_s}
duration_s = {sines_s}
{excite}
[[segment]]
kind = "waypoints"
path = "straight"
points = [
  {{ at_s = 6, elevation_deg = {up}, travel_deg = {corner} }},
  {{ at_s = 12, elevation_deg = -{up}, travel_deg = 0 }},
]
duration_s = 13
[[segment]]
kind = "hold"
duration_s = 8
"""


def random_plan(seed: int, duration_s: float = 60.0) -> Plan:
    """Draw a plan of about `duration_s` in the air: sines, waypoints and hover.

    In half of the plans, a multisine excites the rotors during the sines.
    """
    rng = np.random.default_rng(seed)
    travel_deg = round(float(rng.uniform(10, 40)), 1)
    excite = 'excite = { signal = "multisine", front_V = 0.2, back_V = 0.2, start_Hz = 0.1, stop_Hz = 3 }'
    text = _PLAN.format(
        seed=seed,
        travel=travel_deg,
        # A period in proportion to the amplitude limits the rate of travel.
        travel_s=round(max(16.0, 0.62 * travel_deg), 1),
        elevation=round(float(rng.uniform(2, 9)), 1),
        elevation_s=round(float(rng.uniform(7, 12)), 1),
        sines_s=round(max(duration_s - _OTHER_SEGMENTS_s, _MIN_SINES_s), 1),
        up=round(float(rng.uniform(3, 10)), 1),
        corner=round(float(rng.uniform(10, 40))),
        excite=excite if rng.random() < 0.5 else "",
    )
    return Plan.parse(text, f"healthy-{seed}.toml")


def with_process_noise(model: Model, disturbances: DisturbanceModel) -> Model:
    """Add random gusts and a slow random drift about each axis to a model, for its simulation."""
    specs = catalogue()
    effects: list[Effect] = [effect for effect in model.effects if not effect.noise_inputs]
    for axis, name in enumerate(AXES):
        spec = specs[f"random_torque.{name}"]
        gusts = spec.make(
            {
                spec.full("Nm"): float(disturbances.fast_std[axis]),
                spec.full("s"): float(np.clip(disturbances.correlation_time_s[axis], *_TIME_RANGE_s)),
            }
        )
        slow_std_Nm = float(disturbances.slow_std[axis])
        effects += [
            gusts,
            _with_other_parameters(gusts, f"slow_drift.{name}", slow_std_Nm, SLOW_CORRELATION_TIME_s),
        ]
    return type(model)(tuple(effects))


def _with_other_parameters(gusts: Effect, name: str, std_Nm: float, correlation_time_s: float) -> Effect:
    """Return the same process with another name, standard deviation and correlation time."""
    # Names of parameters and states begin with the effect's name, in which a dot becomes an underscore.
    old_prefix, new_prefix = gusts.prefix, name.replace(".", "_")

    def renamed(quantity: Quantity) -> Quantity:
        return replace(quantity, name=quantity.name.replace(old_prefix, new_prefix))

    return replace(
        gusts,
        name=name,
        parameters=tuple(renamed(parameter) for parameter in gusts.parameters),
        states=tuple(renamed(state) for state in gusts.states),
        values={f"{new_prefix}_Nm": std_Nm, f"{new_prefix}_s": correlation_time_s},
        priors={},
        multimodal=(),
    )


def fly_simulated(model: Model, rig: Rig, plans: Plan | Sequence[Plan], seed: int) -> Flight:
    """Simulate a flight of plans with the flight code on the simulated board.

    A random constant torque acts about each axis.
    """
    rng = np.random.default_rng(seed)
    rig_with_torques = rig.replace(
        **{name: rig[name].value + _TORQUE_SHARE * std * rng.normal() for name, std in TORQUE_STD_Nm.items()}
    )
    with connected(world_of(Plant(model, rig_with_torques, seed), seed)) as heli:
        set_hover(heli, model, rig)
        flight, summary = fly_and_read(heli, plans)
    if not np.any(flight.voltages_V):
        raise FlightAborted(summary.outcome, "check the rig: heli-host rig check FILE")
    return flight
