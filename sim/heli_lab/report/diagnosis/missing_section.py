"""Section of the page about the torques and angles that a model lacks, with and without a cause."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

from heli_lab.explain.discover.missing import TIME, MissingTerm
from heli_lab.explain.wording import capital, readable_id
from heli_lab.report.diagnosis.cause_sections import SaveFigure
from heli_lab.report.diagnosis.result_figures import figure_of_missing_terms

_DOTS: Final = "Each grey dot is 40 ms of the fitted flights; black dots are means."
_OVER_TIME: Final = "Each dot is 40 ms of the seconds in which the cause acts most."
_SMOOTHED: Final = (
    "A Kalman smoother estimates the torque that the model lacks without the {0}; all other parameters stay "
    "the same. It does not use the {1}. Means are subtracted, because a constant torque is a parameter of "
    "the model."
)
_STEADY: Final = "If the cause also changes the steady thrust, the dots contain this change."
_POINTS: Final = (
    "The points are of a smooth curve that is estimated instead of the cause, with two standard errors. This "
    "estimate does not use the equation of the cause."
)
_FAINT: Final = 0.3
"""Share of the variance below which a caption says that the dots hardly show a term."""


def missing_section(
    file: str, terms: Sequence[MissingTerm], save_figure: SaveFigure
) -> dict[str, Any] | None:
    """Draw missing `terms` into a `file`, which `save_figure` writes, and describe it; None without terms."""
    if not terms:
        return None
    return {
        "address": save_figure(file, figure_of_missing_terms(terms)),
        "meaning": "; ".join(f"missing {term.what} about {term.axis} over {term.on}" for term in terms),
        "caption": " ".join([*(_caption(term) for term in terms), *_method_sentences(terms)]),
    }


def _method_sentences(terms: Sequence[MissingTerm]) -> list[str]:
    """Explain in sentences how the terms of a figure were estimated and drawn."""
    torques = [term for term in terms if term.what == "torque"]
    if not torques:
        return [_POINTS]
    lines = []
    if any(term.on != TIME for term in torques):
        lines.append(_DOTS)
    if any(term.on == TIME for term in torques):
        lines.append(_OVER_TIME)
    if any(term.is_spline for term in torques):
        return [*lines, _SMOOTHED.format("curve", "curve")]
    return [*lines, _SMOOTHED.format("cause", "equation of the cause"), _STEADY]


def _caption(term: MissingTerm) -> str:
    """State the share of variance that a cause or curve explains."""
    name, kind = term.id, "equation"
    if term.is_spline:
        name, kind = capital(readable_id(name)), "curve"
    hidden_text = " In this figure, disturbances hide it." if term.share < _FAINT else ""
    return f"{name}: the {kind} explains {100 * max(term.share, 0.0):.0f} % of the variance.{hidden_text}"
