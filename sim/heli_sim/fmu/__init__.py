"""A plant as a functional mock-up unit; see the README in this folder."""

from __future__ import annotations

from heli_sim.fmu.write import write_fmu

__all__ = ["write_fmu"]
