"""Finds what a model lacks, names the cause, and measures what an extension of the model gains."""

from heli_lab.explain.experiment_design import InsufficientExcitation, insufficient_excitation
from heli_lab.explain.result import Diagnosis
from heli_lab.explain.run import diagnose

__all__ = ["Diagnosis", "InsufficientExcitation", "diagnose", "insufficient_excitation"]
