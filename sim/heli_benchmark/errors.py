"""Errors of heli_benchmark, a branch of heli_sim's error classes.

::

    HeliError                   cause, remedy and exit code
    └── SimError                an error in the simulation
        └── BenchmarkError      a split, a method or an answer is invalid
"""

from __future__ import annotations

from heli_sim.errors import SimError


class BenchmarkError(SimError):
    """A split, a method or an answer is invalid."""
