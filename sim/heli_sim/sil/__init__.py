"""Board, plant and clock behind a serial port: pseudo-terminal, TCP, or in process."""

from __future__ import annotations

from heli_sim.sil.options import SilOptions
from heli_sim.sil.world import SilWorld

__all__ = ["SilOptions", "SilWorld"]
