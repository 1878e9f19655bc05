"""Section of the page about the regions in which the models fail."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from heli_sim.model.parts import AXES

from heli_lab.explain.evaluate.regions import FailingRegions, RegionTest
from heli_lab.explain.result import Diagnosis
from heli_lab.explain.wording import quantity_in_words
from heli_lab.report.diagnosis import equation_figures
from heli_lab.report.diagnosis.cause_sections import SaveFigure
from heli_lab.report.page.drawing import Picture


def regions_section(diagnosis: Diagnosis, save_figure: SaveFigure) -> dict[str, Any]:
    """Describe in words and in a figure, which `save_figure` writes, where the models fail about each axis.

    The axis of the verdict is the first.
    """
    first = diagnosis.failing
    all_regions = [first, *(diagnosis.failing_about(axis) for axis in AXES if axis != first.axis)]
    models = _compared_models(diagnosis)
    figure = equation_figures.figure_of_failing_regions(all_regions, models)
    return {
        "address": save_figure("regions", figure),
        "sentences": [_regions_sentence(regions, models) for regions in all_regions],
        "note": _regions_note(diagnosis, first.after if len(models) > 1 else first.before),
    }


def _compared_models(diagnosis: Diagnosis) -> list[str]:
    """Name the models that the regions compare: before and after the last extension of the model."""
    if diagnosis.proposal is not None:
        return ["model with all named causes", "with the proposed equation"]
    if diagnosis.assessment.extended.candidates:
        return ["baseline", "model with all named causes"]
    return ["baseline"]


def _regions_sentence(regions: FailingRegions, models: Sequence[str]) -> str:
    """State the missing torque about an axis, and how often each model fails."""
    texts = []
    for model, test in zip(models, (regions.before, regions.after), strict=False):
        name = model.replace("with the", "model with the")
        share = f"in {100 * test.share:.0f} % of the time" if test.fails.any() else "in no cell"
        texts.append(f"the {name} lacks {_torque_text_mNm(test.rms_Nm)} mN m rms and fails {share}")
    return f"About {regions.axis}: " + "; ".join(texts)


def _regions_note(diagnosis: Diagnosis, test: RegionTest) -> str:
    """Explain an apparent contradiction between the verdict and the cells of the last model; else empty."""
    first = diagnosis.failing
    if diagnosis.label == "unexplained" and not test.fails.any():
        x, y = quantity_in_words(first.x), quantity_in_words(first.y)
        return (
            f"No cell of {x} and {y} fails about {first.axis}, although the model lacks a torque: this "
            "torque is spread over many cells, or depends on other quantities."
        )
    if diagnosis.label != "unexplained" and test.fails.any():
        return (
            "The verdict does not depend on these cells: no candidate explains the missing torque there, "
            "which is small or due to chance."
        )
    return ""


def unknown_torque(diagnosis: Diagnosis, save_figure: SaveFigure) -> Picture | None:
    """Draw the missing torque over its quantity, if neither a curve nor an equation describes it.

    `save_figure` writes the figure. The result is None without such a torque.
    """
    if diagnosis.missing is None or diagnosis.verdict.unlisted or diagnosis.proposal is not None:
        return None
    if (diagnosis.failing.axis, diagnosis.failing.x) != diagnosis.missing:
        return None
    return save_figure("unknown", equation_figures.figure_of_unknown_torque(diagnosis.failing))


def _torque_text_mNm(torque_Nm: float) -> str:
    """Write a torque in mN m: whole numbers from 10 mN m on, two digits below."""
    return f"{1e3 * torque_Nm:.0f}" if torque_Nm >= 0.01 else f"{1e3 * torque_Nm:.2g}"
