"""Comparison of several flights on one page: overlaid angles, and a table of tracking quality."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from heli_host.data.files import save_figure
from heli_host.data.flight import Flight, broken_at_gaps
from heli_host.data.response import effort_V, flown_rows, led_rows, measuring_notes, responses
from heli_host.declaration import AXES
from heli_host.errors import LogWriteError

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def table_lines(rows: Sequence[Sequence[str]], words: Collection[int] = (0,)) -> list[str]:
    """Align the cells of a table in columns, with two spaces between them."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return [
        "  ".join(
            cell.ljust(width) if column in words else cell.rjust(width)
            for column, (cell, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in rows
    ]


HEADS: Final = (
    "flight",
    "axis",
    "step [deg]",
    "rise [s]",
    "overshoot [%]",
    "settling [s]",
    "rms error [deg]",
    "effort [V rms]",
)
_COLOURS: Final = ("#0b5fa5", "#d1495b", "#157a4a", "#c98a00", "#6b3fa0", "#4a8c94", "#8a5a3b", "#5b5f66")
MAX_FLIGHTS: Final = len(_COLOURS)
"""Largest number of flights on one page; each has a colour of its own."""
_METRIC_FORMATS: Final = {
    "step_deg": "+.3g",
    "rise_s": ".2f",
    "overshoot_percent": ".0f",
    "settling_s": ".2f",
    "rms_deg": ".3g",
}
"""Metrics of an axis with their formats, in the order of `HEADS`."""
_WORDS: Final = (0, 1)
"""Columns of a table that hold words; the others hold numbers."""
_LINE_IN: Final = 0.24
_PANELS_IN: Final = 9.0
"""Heights of a line of the table and of all panels [inches]."""
_POINTS: Final = 4000
_DPI: Final = 130


def comparison_numbers(flights: Mapping[str, Flight]) -> list[dict[str, Any]]:
    """Return the metrics of each flight: its label ``flight``, ``effort_V``, and ``axis``."""
    # ``axis`` contains the metrics of a `Response` by the name of the axis; a metric that does not exist is
    # nan.
    return [
        {
            "flight": label,
            "effort_V": effort_V(flight),
            "axis": {
                response.axis: {
                    "step_s": response.step_s,
                    "step_deg": response.step_deg,
                    "rise_s": response.rise_s,
                    "overshoot_percent": response.overshoot_percent,
                    "settling_s": response.settling_s,
                    "rms_deg": response.rms_deg,
                }
                for response in responses(flight)
            },
        }
        for label, flight in flights.items()
    ]


def comparison_rows(numbers: Sequence[Mapping[str, Any]]) -> list[list[str]]:
    """Return the cells of the table with the columns `HEADS`; axes without setpoints are omitted."""
    rows = []
    for entry in numbers:
        label, effort_text = entry["flight"], _number_text(entry["effort_V"], ".2f")
        axes_with_setpoints = {
            axis: metrics for axis, metrics in entry["axis"].items() if not math.isnan(metrics["rms_deg"])
        }
        for axis, metrics in axes_with_setpoints.items():
            cells = [_number_text(metrics[name], form) for name, form in _METRIC_FORMATS.items()]
            rows.append([label, axis, *cells, effort_text])
            label, effort_text = "", ""  # only in the first row of a flight
        if not axes_with_setpoints:
            rows.append([label, "no setpoints", *("–" for _ in _METRIC_FORMATS), effort_text])
    return rows


def comparison_lines(numbers: Sequence[Mapping[str, Any]], flights: Mapping[str, Flight]) -> list[str]:
    """Return the table of `numbers` as lines of text, and what they leave out; they are the result of
    `comparison_numbers` for the `flights`.
    """
    notes = [
        f"note: {label}: {note}" for label, flight in flights.items() for note in measuring_notes(flight)
    ]
    return [*table_lines([HEADS, *comparison_rows(numbers)], _WORDS), *notes]


def _number_text(value: float, form: str) -> str:
    return "–" if math.isnan(value) else f"{value:{form}}"


def split_into_figures(flights: Mapping[str, Flight]) -> list[dict[str, Flight]]:
    """Return the flights of each figure by label; the first flight is in each, for comparison."""
    (first, *others), others_per_figure = list(flights.items()), MAX_FLIGHTS - 1
    starts = range(0, max(len(others), 1), others_per_figure)
    return [dict([first, *others[start : start + others_per_figure]]) for start in starts]


def write_comparisons(flights: Mapping[str, Flight], path: Path) -> list[Path]:
    """Draw any number of flights, `MAX_FLIGHTS` per file: ``NAME.png``, ``NAME-2.png`` and so on."""
    parts = split_into_figures(flights)
    files = [path, *(path.with_stem(f"{path.stem}-{number}") for number in range(2, len(parts) + 1))]
    for part, file in zip(parts, files, strict=True):
        write_comparison(part, file)
    return files


def write_comparison(flights: Mapping[str, Flight], path: str | Path) -> None:
    """Draw flights over each other into a file; time 0 is the moment when the control law of each began."""
    path = Path(path)
    figure = figure_of_flights(flights)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        save_figure(figure, path, dpi=_DPI, facecolor="white")
    except (OSError, ValueError) as error:
        raise LogWriteError(f"cannot write {path}: {error}", "give a .png, .pdf or .svg file") from error


def figure_of_flights(flights: Mapping[str, Flight]) -> Figure:
    """Draw the angles of all flights with dashed setpoints, their mean voltages, and a table of metrics."""
    from matplotlib.figure import Figure

    rows = comparison_rows(comparison_numbers(flights))
    table_in = _LINE_IN * (len(rows) + 2)  # the heads, and a line of space
    height_in = _PANELS_IN + table_in
    figure = Figure(figsize=(12.0, height_in))
    *angle_panels, volts_panel = figure.subplots(len(AXES) + 1, 1, sharex=True, height_ratios=[3, 3, 3, 2])
    # Space below for the label of the time and the table, and above for the legend.
    figure.subplots_adjust(
        left=0.07, bottom=(table_in + 0.75) / height_in, right=0.985, top=1.0 - 0.5 / height_in, hspace=0.12
    )
    for (label, flight), colour in zip(flights.items(), _COLOURS, strict=False):
        flown = np.flatnonzero(flown_rows(flight))
        t_s = flight.t_s - flight.t_s[flown[0] if flown.size else 0]
        thinned = slice(None, None, max(1, len(flight) // _POINTS))
        for axis, panel in zip(AXES, angle_panels, strict=True):
            setpoint_rad = getattr(flight, f"{axis}_setpoint_rad")
            if setpoint_rad is not None:
                setpoint_deg = np.where(led_rows(flight, axis), np.rad2deg(setpoint_rad), np.nan)
                dashes = broken_at_gaps(t_s[thinned], setpoint_deg[thinned])
                panel.plot(*dashes, "--", color=colour, lw=0.9, alpha=0.6)
            angle_deg = np.rad2deg(getattr(flight, f"{axis}_rad"))[thinned]
            panel.plot(*broken_at_gaps(t_s[thinned], angle_deg), color=colour, lw=1.3, label=label)
        mean_V = flight.voltages_V.mean(axis=1)[thinned]  # of both motors
        volts_panel.plot(*broken_at_gaps(t_s[thinned], mean_V), color=colour, lw=0.8)
    for axis, panel in zip(AXES, angle_panels, strict=True):
        panel.set_ylabel(f"{axis} [deg]")
    volts_panel.set_ylabel("mean of both\nvoltages [V]")
    volts_panel.set_xlabel("time since the control law began [s]; dashed: setpoints")
    for panel in (*angle_panels, volts_panel):
        panel.grid(alpha=0.25)
        panel.margins(x=0.01)
    figure.legend(
        *angle_panels[0].get_legend_handles_labels(), loc="upper center", ncols=4, fontsize=9, frameon=False
    )
    # In shares of the figure: left, bottom, width, height.
    _draw_table(figure.add_axes((0.03, 0.1 / height_in, 0.955, table_in / height_in)), rows)
    return figure


def _draw_table(table_axes: Axes, rows: list[list[str]]) -> None:
    """Draw a table with the columns `HEADS`."""
    table_axes.set_axis_off()
    flight_width, axis_width = 0.24, 0.12
    number_columns = len(HEADS) - len(_WORDS)
    number_width = (1.0 - flight_width - axis_width) / number_columns
    text_table = table_axes.table(
        cellText=rows,
        colLabels=list(HEADS),
        loc="center",
        cellLoc="center",
        edges="horizontal",
        colWidths=[flight_width, axis_width, *[number_width] * number_columns],
    )
    text_table.auto_set_font_size(False)
    text_table.set_fontsize(8.5)
    for cell in text_table.get_celld().values():
        cell.set_edgecolor("#c9cdd2")
