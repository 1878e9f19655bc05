"""Shows what a model lacks, names it, and measures what naming it gains."""

from __future__ import annotations

from heli_lab.diagnose.result import Diagnosis
from heli_lab.diagnose.run import diagnose

__all__ = ["Diagnosis", "diagnose"]
