"""Diagnosis and what to print of it: ``from heli_lab.diagnose import diagnose, summary``."""

from heli_lab.explain import Diagnosis, InsufficientExcitation, diagnose, insufficient_excitation
from heli_lab.report.diagnosis.serialize import to_json
from heli_lab.report.diagnosis.text import summary

__all__ = ["Diagnosis", "InsufficientExcitation", "diagnose", "insufficient_excitation", "summary", "to_json"]
