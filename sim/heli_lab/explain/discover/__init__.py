"""Discovery of what the catalogue lacks: equations, spline terms as curves, and the missing torque along
flights.
"""

from heli_lab.explain.discover.discovery import Discovery
from heli_lab.explain.discover.effect_contribution import accelerations
from heli_lab.explain.discover.equation import CHANNELS, NAME
from heli_lab.explain.discover.missing import TIME, MissingTerm
from heli_lab.explain.discover.notation import expression, latex
from heli_lab.explain.discover.proposal import ProposedTerm, proposed_term
from heli_lab.explain.discover.spline_curve import SplineCurve, spline_curves_of
from heli_lab.explain.discover.symbolic_regression import discover
from heli_lab.explain.discover.terms import SYMBOLS
from heli_lab.explain.discover.without_cause import missing_term

__all__ = [
    "CHANNELS",
    "NAME",
    "SYMBOLS",
    "TIME",
    "Discovery",
    "MissingTerm",
    "ProposedTerm",
    "SplineCurve",
    "accelerations",
    "discover",
    "expression",
    "latex",
    "missing_term",
    "proposed_term",
    "spline_curves_of",
]
