"""Section of the page about the regions in which the models fail."""

from __future__ import annotations

from typing import Any

from heli_sim.model.parts import AXES

from heli_lab.diagnose.report import equation_figures
from heli_lab.diagnose.report.cause_sections import Kept
from heli_lab.diagnose.result import Diagnosis
from heli_lab.diagnose.wording import quantity_in_words
from heli_lab.page.drawing import Picture


def regions_section(diagnosis: Diagnosis, kept: Kept) -> dict[str, Any]:
    """Where the models fail about each axis, in words and in a figure, which `kept` writes. The axis of the
    verdict is the first.
    """
    first = diagnosis.failing
    all_regions = [first, *(diagnosis.failing_about(axis) for axis in AXES if axis != first.axis)]
    models = ["baseline", "model with all named causes"]
    if diagnosis.proposal is not None:
        models = [models[1], "with the proposed equation"]
    elif not diagnosis.assessment.extended.candidates:
        models = models[:1]
    return {
        "address": kept("regions", equation_figures.figure_of_failing_regions(all_regions, models)),
        "said": [
            f"About {regions.axis}: "
            + "; ".join(
                f"the {model} lacks {_mNm(test.rms_Nm)} mN m rms and fails "
                + (f"in {100 * test.share:.0f} % of the time" if test.fails.any() else "in no cell")
                for model, test in zip(
                    (name.replace("with the", "model with the") for name in models),
                    (regions.before, regions.after),
                    strict=False,
                )
            )
            for regions in all_regions
        ],
        "note": _regions_note(diagnosis, len(models) > 1),
    }


def _regions_note(diagnosis: Diagnosis, two: bool) -> str:
    """How the cells agree with the verdict, where they seem not to."""
    first = diagnosis.failing
    test = first.after if two else first.before
    if diagnosis.label == "unexplained" and not test.fails.any():
        x, y = quantity_in_words(first.x), quantity_in_words(first.y)
        return (
            f"No cell of {x} and {y} fails about {first.axis}, although something is missing there: it is "
            "spread over many cells, or depends on other quantities."
        )
    if diagnosis.label != "unexplained" and test.fails.any():
        return (
            "The verdict does not depend on these cells: no candidate explains the missing torque there, "
            "which is small or due to chance."
        )
    return ""


def unknown_torque(diagnosis: Diagnosis, kept: Kept) -> Picture | None:
    """Draw an unknown without a curve, if it depends on a quantity of a plane; `kept` writes the figure."""
    if diagnosis.missing is None or diagnosis.verdict.unlisted or diagnosis.proposal is not None:
        return None
    if (diagnosis.failing.axis, diagnosis.failing.x) != diagnosis.missing:
        return None
    return kept("unknown", equation_figures.figure_of_unknown_torque(diagnosis.failing))


def _mNm(torque_Nm: float) -> str:
    return f"{1e3 * torque_Nm:.0f}" if torque_Nm >= 0.01 else f"{1e3 * torque_Nm:.2g}"
