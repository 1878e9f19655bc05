"""Diagnosis and what to print of it: ``from heli_lab.diagnose import diagnose, summary``."""

from heli_lab.explain import Diagnosis, InsufficientExcitation, diagnose, insufficient_excitation
from heli_lab.report.diagnosis.sentences import summary
from heli_lab.report.diagnosis.serialize import to_json

__all__ = ["Diagnosis", "InsufficientExcitation", "diagnose", "insufficient_excitation", "summary", "to_json"]
