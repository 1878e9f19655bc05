"""Effects that a model may be extended by, one file each."""

from __future__ import annotations

from heli_sim.model.effects.rotor_lag import RotorLag

__all__ = ["RotorLag"]
