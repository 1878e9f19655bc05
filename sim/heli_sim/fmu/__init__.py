"""A plant as a functional mock-up unit (FMI 3.0), for other simulators."""

from __future__ import annotations

from heli_sim.fmu.write import write_fmu

__all__ = ["write_fmu"]
