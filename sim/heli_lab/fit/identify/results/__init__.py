"""Results of a fit: checks on flights, standard errors as JSON, and a rig that can be flown."""

from heli_lab.fit.identify.results.check import FreeRunErrors, Trace, check, trace, validate
from heli_lab.fit.identify.results.explained import refuse_unexplained, unexcited_axes
from heli_lab.fit.identify.results.identification import Identification, rounded, short_names

__all__ = [
    "FreeRunErrors",
    "Identification",
    "Trace",
    "check",
    "refuse_unexplained",
    "rounded",
    "short_names",
    "trace",
    "unexcited_axes",
    "validate",
]
