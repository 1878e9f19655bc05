"""The simulated rig: its parameters and equations, the board that flies it, and a serial port for hosts."""

from __future__ import annotations

from heli_sim.errors import EndpointError, OptionError, PlantError, RigError, SimError

__all__ = ["EndpointError", "OptionError", "PlantError", "RigError", "SimError"]
