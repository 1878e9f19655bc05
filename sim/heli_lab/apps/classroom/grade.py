"""Grade control laws by their flights and stability margins, and write the page that compares them."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from heli_host.board.law_program import LawProgram
from heli_host.data.flight import Flight
from heli_host.data.log.comparison import figure_of_flights, split_into_figures, table_lines
from heli_host.data.response import effort_V, responses
from heli_host.declaration import AXES, LAW_INPUTS
from heli_host.errors import BadLaw, FlightAborted, FlightDataError, HeliError

from heli_lab.control.law_flight import LawTrial
from heli_lab.control.linear_law import linearised
from heli_lab.control.program_json import law_of_program
from heli_lab.control.tune.loops import LinearPlant
from heli_lab.report.page import folder_with, write_page
from heli_lab.report.page.drawing import Drawing

REFERENCE: Final = "the board's own"
"""Label of the control law to which the others are compared."""
HEADS: Final = (
    "law",
    "settling [s]",
    "overshoot [%]",
    "rms elevation [deg]",
    "rms travel [deg]",
    "effort [V rms]",
    "taken over",
    "gain margin",
    "phase margin [deg]",
)

_FIRST_SETPOINT: Final = 2
"""Index of the elevation setpoint in the outputs of a program."""

FlyTrial = Callable[[LawProgram | None, str, int], LawTrial]
"""Flies a law, or the board's own law for None, on the rig of a name with a seed."""


@dataclass(frozen=True)
class FlightScore:
    """Measures of how well one flight followed its setpoints."""

    settling_s: float = math.nan
    """settling_s, overshoot_percent: Settling time and overshoot of the largest setpoint step of elevation or
    travel; nan if there is no step, infinite if the axis did not settle."""
    overshoot_percent: float = math.nan
    elevation_rms_deg: float = math.nan
    """elevation_rms_deg, travel_rms_deg: RMS tracking error; nan for an axis without setpoints."""
    travel_rms_deg: float = math.nan
    effort_V: float = math.nan  # RMS of the motor voltages about their mean
    ended: str = ""  # Why the law did not complete the flight; empty if it did

    @property
    def rms_deg(self) -> float:
        """Root of the sum of squares of both RMS tracking errors."""
        errors_deg = np.array([self.elevation_rms_deg, self.travel_rms_deg])
        return math.nan if np.isnan(errors_deg).all() else float(np.sqrt(np.nansum(errors_deg**2)))

    def as_dict(self) -> dict[str, Any]:
        """Return the measures for JSON."""
        return asdict(self)


NUMBERS: Final = ("settling_s", "overshoot_percent", "elevation_rms_deg", "travel_rms_deg", "effort_V")
"""Names of the measures of a score."""


@dataclass(frozen=True)
class LawGrade:
    """Grade of one law."""

    label: str  # Name for readers; each law has another one
    refused: str = ""  # Why the law did not fly at all; empty if it flew
    scores: tuple[FlightScore, ...] = ()  # One per rig and seed, in the order of the flights
    gain_margin: float = math.nan
    """gain_margin, phase_margin_deg: Smaller margin of the collective and the differential on the first rig;
    nan if there is none."""
    phase_margin_deg: float = math.nan
    flight: Flight | None = None  # First flight, for the figure

    @property
    def takeovers(self) -> int:
        """Number of flights that the law did not complete."""
        return sum(bool(score.ended) for score in self.scores)

    @property
    def passed(self) -> bool:
        """Whether the law completed all flights."""
        return not self.refused and not self.takeovers

    def mean(self, name: str) -> float:
        """Return the mean of a measure over the flights; nan if a flight lacks the measure."""
        values = [getattr(score, name) for score in self.scores]
        return float(np.mean(values)) if values else math.nan

    def as_dict(self) -> dict[str, Any]:
        """Return the grade for JSON."""
        return {
            "law": self.label,
            "refused": self.refused,
            "takeovers": self.takeovers,
            "gain_margin": self.gain_margin,
            "phase_margin_deg": self.phase_margin_deg,
            "mean": {name: self.mean(name) for name in NUMBERS},
            "flights": [score.as_dict() for score in self.scores],
        }

    def _settling_text(self) -> str:
        """Return the mean settling time of the flights that settled, and their number if some did not."""
        settled_s = [score.settling_s for score in self.scores if math.isfinite(score.settling_s)]
        unsettled_count = sum(math.isinf(score.settling_s) for score in self.scores)
        if not settled_s:
            return "never" if unsettled_count else "–"
        some_text = f" in {len(settled_s)} of {len(self.scores)}" if len(settled_s) < len(self.scores) else ""
        return f"{np.mean(settled_s):.2f}{some_text}"

    def row(self) -> list[str]:
        """Return the cells of a table under `HEADS`."""
        if self.refused:
            return [self.label, *["–"] * 5, "refused", "–", "–"]
        return [
            self.label,
            self._settling_text(),
            _format_number(self.mean("overshoot_percent"), ".0f"),
            _format_number(self.mean("elevation_rms_deg"), ".3f"),
            _format_number(self.mean("travel_rms_deg"), ".3f"),
            _format_number(self.mean("effort_V"), ".2f"),
            f"{self.takeovers} of {len(self.scores)}",
            _format_number(self.gain_margin, ".2f"),
            _format_number(self.phase_margin_deg, ".0f"),
        ]


def with_plan_setpoints(program: LawProgram) -> LawProgram:
    """Return a law with the same voltages that logs the plan's setpoints of elevation and travel."""
    # A law may log setpoints that it computes. A law that logs the measured angles as setpoints would have no
    # error. Therefore, a grade uses the setpoints of the plan.
    outputs = list(program.outputs)
    for axis in ("elevation", "travel"):
        outputs[_FIRST_SETPOINT + AXES.index(axis)] = LAW_INPUTS.index(f"{axis}_setpoint_rad")
    return replace(program, outputs=tuple(outputs))


def score_of_trial(trial: LawTrial) -> FlightScore:
    """Compute the score of a flight: errors of both axes, and the metrics of its largest setpoint step."""
    elevation, _, travel = responses(trial.flight)
    with_steps = [response for response in (elevation, travel) if not math.isnan(response.step_deg)]
    step_response = max(with_steps, key=lambda response: abs(response.step_deg), default=elevation)
    settling_s = step_response.settling_s
    if with_steps and math.isnan(settling_s):
        settling_s = math.inf  # The response did not settle.
    return FlightScore(
        settling_s=settling_s,
        overshoot_percent=step_response.overshoot_percent,
        elevation_rms_deg=elevation.rms_deg,
        travel_rms_deg=travel.rms_deg,
        effort_V=effort_V(trial.flight),
        ended=trial.taken_over,
    )


def grade(
    label: str,
    program: LawProgram | None,
    flights: Sequence[tuple[str, int]],
    fly: FlyTrial,
    plant: LinearPlant | None = None,
) -> LawGrade:
    """Fly a law on each rig with each seed, and grade it; without `program`, the board's own law."""
    # Without a linear `plant`, the margins are unknown.
    scores: list[FlightScore] = []
    first_flight: Flight | None = None
    try:
        graded_program = with_plan_setpoints(program) if program is not None else None
    except BadLaw as error:
        return LawGrade(label, str(error))
    for rig, seed in flights:
        try:
            trial = fly(graded_program, rig, seed)
        except HeliError as error:
            # With the board's own law, an error is not the law's fault, unless the flight itself ended early.
            if program is None and not isinstance(error, FlightAborted | FlightDataError):
                raise
            scores.append(FlightScore(ended=error.cause))
            continue
        scores.append(score_of_trial(trial))
        first_flight = trial.flight if first_flight is None else first_flight
    gain_margin, phase_margin_deg = _margins(program, plant)
    return LawGrade(
        label,
        scores=tuple(scores),
        gain_margin=gain_margin,
        phase_margin_deg=phase_margin_deg,
        flight=first_flight,
    )


def _margins(program: LawProgram | None, plant: LinearPlant | None) -> tuple[float, float]:
    """Return gain margin (factor) and phase margin [deg] of a law: the smaller of collective and
    differential.
    """
    # Both are nan without a law or a linear rig, and if the closed loop is unstable.
    if program is None or plant is None:
        return math.nan, math.nan
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        # There is a warning for each frequency above half of the law's rate.
        warnings.simplefilter("ignore")
        try:
            linear = linearised(law_of_program(program), plant)
        # A law whose output at level is nan has no margins.
        except (ValueError, np.linalg.LinAlgError):
            return math.nan, math.nan
    if not linear.stable:
        return math.nan, math.nan
    return min(linear.gain_up), min(linear.phase_deg)


def grade_lines(grades: Sequence[LawGrade]) -> list[str]:
    """Return the table of grades as lines of text, and a line for each reason."""
    return table_lines([HEADS, *(law_grade.row() for law_grade in grades)]) + reasons(grades)


def reasons(grades: Sequence[LawGrade]) -> list[str]:
    """Return a line for each law that was refused or did not fly to its end."""
    lines = []
    for law_grade in grades:
        if law_grade.refused:
            lines.append(f"{law_grade.label}: refused: {law_grade.refused}")
        elif law_grade.takeovers:
            causes = sorted({score.ended for score in law_grade.scores if score.ended})
            lines.append(f"{law_grade.label}: did not fly to the end: {', '.join(causes)}")
    return lines


def _format_number(value: float, form: str) -> str:
    """Format a number as the format specification `form` says; nan becomes a dash."""
    return "–" if math.isnan(value) else f"{value:{form}}"


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
