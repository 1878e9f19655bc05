"""Combine diagnoses of several rigs of one type and estimate how their parameters vary."""

from heli_lab.apps.pool.population import RigPopulation, pool
from heli_lab.apps.pool.random_effects import RandomEffects, Share, der_simonian_laird, share
from heli_lab.apps.pool.rig_diagnosis import RigDiagnosis, read_rig_diagnosis

__all__ = [
    "RandomEffects",
    "RigDiagnosis",
    "RigPopulation",
    "Share",
    "der_simonian_laird",
    "pool",
    "read_rig_diagnosis",
    "share",
]
