"""Diagnosis: finds what a model lacks, names the cause, and measures what an extension of the model gains."""

from __future__ import annotations

from heli_lab.diagnose.insufficient_excitation import InsufficientExcitation, insufficient_excitation
from heli_lab.diagnose.report import summary, to_json
from heli_lab.diagnose.result import Diagnosis
from heli_lab.diagnose.run import diagnose

__all__ = ["Diagnosis", "InsufficientExcitation", "diagnose", "insufficient_excitation", "summary", "to_json"]
