"""Write the HTML page of grades: a table, and figures that compare the flights of several laws."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from heli_host.data.flight import Flight
from heli_host.data.log.comparison import figure_of_flights, split_into_figures

from heli_lab.apps.classroom.grade import HEADS, LawGrade, reasons
from heli_lab.report.page import folder_with, write_page
from heli_lab.report.page.drawing import Drawing

_TEMPLATE: Final = Path(__file__).with_name("grade.html")


def write_grades(grades: Sequence[LawGrade], content: Mapping[str, Any], folder: Path) -> Path:
    """Write index.html, result.json and the figures into a folder; return the path of the page."""
    folder = folder_with(content, folder)
    drawing = Drawing()
    figures = [
        {"address": drawing.add(figure_of_flights(flights), folder / f"flights-{number}.png"), "names": names}
        for number, (flights, names) in enumerate(_flights_per_figure(grades), 1)
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


def _flights_per_figure(grades: Sequence[LawGrade]) -> list[tuple[dict[str, Flight], str]]:
    """Divide the flights into figures, each of which contains the flight of the first grade."""
    # The flights differ by their seeds, so that the numbers of one differ from the means of the table.
    flight_by_label = {
        f"{grade.label}, first flight" + (", taken over" if grade.scores[0].ended else ""): grade.flight
        for grade in grades
        if grade.flight is not None
    }
    if not flight_by_label:
        return []
    figures = []
    for flights in split_into_figures(flight_by_label):
        labels = list(flights)
        figures.append((flights, ", ".join(labels[1:] or labels)))
    return figures
