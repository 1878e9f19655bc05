"""Report of a diagnosis: sentences, JSON, figures and pages."""

from heli_lab.report.diagnosis.page import (
    missing_terms,
    write_effect_file,
    write_insufficient_excitation,
    write_report,
)
from heli_lab.report.diagnosis.sentences import lines, summary, title, unconfirmed_in_rig
from heli_lab.report.diagnosis.serialize import to_json

__all__ = [
    "lines",
    "missing_terms",
    "summary",
    "title",
    "to_json",
    "unconfirmed_in_rig",
    "write_effect_file",
    "write_insufficient_excitation",
    "write_report",
]
