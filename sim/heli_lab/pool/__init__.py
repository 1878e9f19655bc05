"""Diagnoses of several machines of one make, together."""

from heli_lab.pool.machine import Machine, read_machine
from heli_lab.pool.population import RigPopulation, pool
from heli_lab.pool.random_effects import RandomEffects, Share, der_simonian_laird, share

__all__ = [
    "Machine",
    "RandomEffects",
    "RigPopulation",
    "Share",
    "der_simonian_laird",
    "pool",
    "read_machine",
    "share",
]
