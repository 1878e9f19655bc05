"""The page of grades: the table, and figures with the flights over each other."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from heli_host.flight import Flight
from heli_host.log.comparison import figure_of_flights, split_into_figures

from heli_lab.classroom.grade import HEADS, LawGrade, reasons
from heli_lab.page import folder_with, write_page
from heli_lab.page.drawing import Drawing

_TEMPLATE: Final = Path(__file__).with_name("grade.html")


def write_grades(grades: Sequence[LawGrade], content: Mapping[str, Any], folder: Path) -> Path:
    """Write index.html, result.json and the figures into a folder; return the page.

    Parameters
    ----------
    grades : sequence of LawGrade
        The first is the one to which each figure compares the others.
    content : mapping
        Result for JSON, with the settings of the flights.
    folder : Path
        Folder, made if it is missing.
    """
    folder = folder_with(content, folder)
    drawing = Drawing()
    figures = [
        {"address": drawing.add(figure_of_flights(flights), folder / f"flights-{number}.png"), "names": names}
        for number, (flights, names) in enumerate(_figures(grades), 1)
    ]
    return write_page(
        folder,
        _TEMPLATE,
        title="Grades of control laws",
        heads=HEADS,
        rows=[grade.row() for grade in grades],
        reasons=reasons(grades),
        figures=figures,
        settings=content,
    )


def _figures(grades: Sequence[LawGrade]) -> list[tuple[dict[str, Flight], str]]:
    """Flights of each figure by label, the first grade in each, and the names of the others."""
    flight_by_label = {grade.label: grade.flight for grade in grades if grade.flight is not None}
    if not flight_by_label:
        return []
    return [(part, ", ".join(list(part)[1:] or part)) for part in split_into_figures(flight_by_label)]
