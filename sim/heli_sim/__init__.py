"""The simulated rig: numbers, equations, the board it flies with and the serial port it shows."""

from __future__ import annotations

from heli_sim.errors import EndpointError, OptionError, PlantError, RigError, SimError

__all__ = ["EndpointError", "OptionError", "PlantError", "RigError", "SimError"]
