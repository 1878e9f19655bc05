"""Shows what a model lacks, names it, and measures what naming it gains."""

from __future__ import annotations

from heli_lab.diagnose.result import Diagnosis
from heli_lab.diagnose.run import diagnose
from heli_lab.diagnose.serialize import to_json
from heli_lab.diagnose.summary import summary

__all__ = ["Diagnosis", "diagnose", "summary", "to_json"]
