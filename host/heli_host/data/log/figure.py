"""Figure of a flight: setpoint and measured angles, voltages, states and events on one page."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from heli_host.data.files import save_figure
from heli_host.data.flight import Flight, FlightEvent, broken_at_gaps, find_gaps
from heli_host.data.log.summary import FlightSummary
from heli_host.data.response import LANDING, PHASE_EVENT, TAKE_OFF
from heli_host.declaration import AXES, Takeover
from heli_host.errors import LogWriteError

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_MEASURED = {"elevation": "#0b5fa5", "pitch": "#b3420f", "travel": "#157a4a"}
_FRONT, _BACK = "#6b3fa0", "#c98a00"
_SETPOINT = "#222222"
_STATE_COLOURS = {
    "idle": "#e6e6e6",
    "armed": "#ffe9a8",
    "closed_loop": "#d6ecd2",
    "open_loop": "#e3d7f1",
    "streamed": "#d3e5f5",
    "hold": "#ffd9b0",
    "landing": "#d5e3ee",
    "fault": "#f6b8b3",
}
_SERIOUS_EVENTS = frozenset(
    {
        "board_restarted",
        "fault",
        "link_lost",
        "link_restored",
        "law_taken_over",
        "link_silent",
        "setpoint_rejected",
        "setpoint_stale",
    }
)
_BUCKETS = 3000
_HALF_SPAN_DEG = 1.0
_STATE_ROW, _PLAN_ROW = 0, 1
_MAX_GAPS = 200
_MAX_EVENTS = 40
_GAP_COLOUR = "#e58b85"
_DPI = 130


def write_figure(flight: Flight, summary: FlightSummary, path: str | Path) -> None:
    """Draw a flight into a file."""
    figure = draw(flight, summary)
    path = Path(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        save_figure(figure, path, dpi=_DPI, facecolor="white")
    except (OSError, ValueError) as error:
        raise LogWriteError(f"cannot write {path}: {error}", "give a .png, .pdf or .svg file") from error


def draw(flight: Flight, summary: FlightSummary) -> Figure:
    """Draw a flight."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12.0, 9.2), layout="constrained")
    FigureCanvasAgg(figure)  # draws without a window
    signals = [name for name in flight.meta.get("law_signals", "").split(", ") if name in flight.extra]
    # From above: the band of the strips, the axes, the law's signals in one panel if it has some, voltages.
    heights = [0.62, *(3.0 for _ in AXES), *([2.2] if signals else []), 2.2]
    rows = figure.subplots(len(heights), 1, sharex=True, gridspec_kw={"height_ratios": heights})
    band, *panels, volts = rows
    axis_panels, signal_panels = panels[: len(AXES)], panels[len(AXES) :]
    t_s = flight.t_s - flight.t_s[0] if len(flight) else flight.t_s
    for axis, panel in zip(AXES, axis_panels, strict=True):
        _draw_axis(panel, flight, t_s, axis, summary)
    for panel in signal_panels:
        _draw_signals(panel, flight, t_s, signals)
    _draw_voltages(volts, flight, t_s)
    _draw_strips(band, (*panels, volts), flight, t_s)
    _draw_events((*panels, volts), flight)
    volts.set_xlabel("time since the first logged tick [s]")
    if len(t_s):
        volts.set_xlim(0.0, max(float(t_s[-1]), 1e-3))  # a single row has no width
    figure.align_ylabels([*panels, volts])
    figure.suptitle(_headline(summary), fontsize=15, fontweight="bold", x=0.012, ha="left")
    colour = "#444444" if summary.completed or summary.outcome == "recorded" else "#a01820"
    band.set_title(_subtitle(summary), fontsize=9.5, loc="left", color=colour)
    return figure


def _headline(summary: FlightSummary) -> str:
    """Return the plans, the rig and the outcome without its reason."""
    flown = " + ".join(summary.plans) if summary.plans else "flight"
    rig = f" on {summary.rig}" if summary.rig else ""
    short = summary.outcome.partition(":")[0]
    return f"{flown}{rig}: {short}"


def _subtitle(summary: FlightSummary) -> str:
    """Return the lines below the headline: duration, lost ticks, link counters, board and remarks."""
    lost_text = f"{summary.ticks_lost:,} lost" if summary.ticks_lost else "none lost"
    link = summary.link
    phrases = [
        f"{summary.duration_s:.1f} s, {summary.ticks_logged:,} ticks logged, {lost_text}",
        f"link: {_count_text(link, 'frames_ok', 'frame')}, {link.get('frames_bad', 0)} bad, "
        f"{_count_text(link, 'retries', 'retry')}, {_count_text(link, 'reconnects', 'reconnect')}",
    ]
    if summary.board:
        phrases.append(summary.board)
    paragraphs = ["   ·   ".join([*phrases, *summary.notes])]
    if ":" in summary.outcome:
        paragraphs.insert(0, summary.outcome)  # The headline lacks the reason behind the colon.
    return "\n".join(line for paragraph in paragraphs for line in textwrap.wrap(paragraph, 150))


def _count_text(link: Mapping[str, int], name: str, noun: str) -> str:
    number = link.get(name, 0)
    plural = f"{noun[:-1]}ies" if noun.endswith("y") else f"{noun}s"
    return f"{number:,} {noun if number == 1 else plural}"


def _draw_axis(
    panel: Axes, flight: Flight, t_s: NDArray[np.float64], axis: str, summary: FlightSummary
) -> None:
    """Draw angle and setpoint of an axis [deg] over time [s], with the tracking error as its title."""
    column = AXES.index(axis)
    measured_deg = np.rad2deg(flight.angles_rad[:, column])
    setpoints_rad = flight.setpoints_rad
    panel.plot(*_envelope(t_s, measured_deg), color=_MEASURED[axis], lw=1.4, label="measured", zorder=3)
    if setpoints_rad is not None:
        # The travel loop's pitch setpoint has the steps of the encoder, so it is drawn behind the angle.
        thin, dashed = {"lw": 0.6, "zorder": 2.5}, {"lw": 1.0, "ls": (0, (5, 2)), "zorder": 4}
        panel.plot(
            *_envelope(t_s, np.rad2deg(setpoints_rad[:, column])),
            color=_SETPOINT,
            label="setpoint",
            **(thin if axis == "pitch" else dashed),
        )
    middle_deg = float(measured_deg.max() + measured_deg.min()) / 2 if len(measured_deg) else 0.0
    # The panel covers at least this, so that a count of the encoder does not look like a motion.
    panel.update_datalim([(0.0, middle_deg - _HALF_SPAN_DEG), (0.0, middle_deg + _HALF_SPAN_DEG)])
    panel.set_ylabel(f"{axis} [°]")
    rms, largest_error = summary.rms_error_deg.get(axis), summary.max_error_deg.get(axis)
    error_text = (
        f"error {rms:.2f}° rms, {largest_error:.2f}° at most{_counted_text(flight)}"
        if rms is not None and largest_error is not None
        else "no closed loop to judge"
    )
    panel.set_title(f"{axis}: {error_text}", fontsize=10, loc="left")
    _finish_panel(panel)


def _counted_text(flight: Flight) -> str:
    """Return which part of a flight its tracking error counts; the figure shows the whole flight."""
    phases = {event.text for event in flight.events if event.name == PHASE_EVENT}
    left_out = [phase for phase in (TAKE_OFF, LANDING) if phase in phases]
    return f", without {' and '.join(left_out)}" if left_out else ""


def _draw_voltages(panel: Axes, flight: Flight, t_s: NDArray[np.float64]) -> None:
    """Draw both motor voltages."""
    panel.plot(*_envelope(t_s, flight.front_V), color=_FRONT, lw=1.0, label="front", zorder=3)
    panel.plot(*_envelope(t_s, flight.back_V), color=_BACK, lw=1.0, label="back", alpha=0.8, zorder=3)
    panel.set_ylabel("voltage [V]")
    panel.set_title("motor voltages that acted", fontsize=10, loc="left")
    _finish_panel(panel)


def _draw_signals(panel: Axes, flight: Flight, t_s: NDArray[np.float64], signals: Sequence[str]) -> None:
    """Draw the signals that a control law logged."""
    for name, colour in zip(signals, (*_MEASURED.values(), _FRONT), strict=False):
        panel.plot(*_envelope(t_s, flight.extra[name]), color=colour, lw=1.0, label=name, zorder=3)
    panel.set_ylabel("signals")
    panel.set_title("signals of the control law", fontsize=10, loc="left")
    _finish_panel(panel)


def _finish_panel(panel: Axes) -> None:
    """Give a panel its grid, margins and legend."""
    panel.grid(True, color="#bbbbbb", lw=0.5, alpha=0.6)
    panel.margins(y=0.12)
    for side in ("top", "right"):
        panel.spines[side].set_visible(False)
    panel.legend(
        loc="lower right",
        bbox_to_anchor=(1.0, 0.99),
        ncols=2,
        fontsize=8.5,
        frameon=False,
        borderpad=0.1,
        borderaxespad=0.1,
        handlelength=2.2,
    )


def _draw_strips(band: Axes, panels: Sequence[Axes], flight: Flight, t_s: NDArray[np.float64]) -> None:
    """Draw two strips, one with the phases of the plan and one with the board's state; shade the panels."""
    # Each strip is 1 high, so that its label is at the half.
    band.set_ylim(0.0, 2.0)
    band.set_yticks([0.5, 1.5] if flight.state is not None else [], ["state", "plan"], fontsize=8.5)
    band.tick_params(axis="both", length=0, labelbottom=False)
    for spine in band.spines.values():
        spine.set_visible(False)
    if flight.state is None or not len(flight):
        return
    draw_block = partial(_draw_block, band, total_s=flight.duration_s)
    phases = [event for event in flight.events if event.name == PHASE_EVENT]
    phase_starts_s = [_time_in_figure_s(event, flight) for event in phases]
    motors_off_s = flight.duration_s
    for start, stop, number in _state_runs(flight.state):
        start_s, stop_s = float(t_s[start]), float(t_s[min(stop, len(t_s) - 1)])
        name = flight.state_names.get(number, str(number))
        colour = _STATE_COLOURS.get(name, "#dddddd")
        draw_block(start_s, stop_s, row=_STATE_ROW, text=name.replace("_", " "), colour=colour)
        for panel in panels:
            panel.axvspan(start_s, stop_s, color=colour, alpha=0.28, lw=0, zorder=0)
        if name in ("idle", "fault") and start_s > max(phase_starts_s, default=0.0):
            motors_off_s = min(motors_off_s, start_s)
    # The last phase, usually a landing, ends when the motors are off.
    phase_ends_s = [*phase_starts_s[1:], motors_off_s]
    for phase, start_s, end_s in zip(phases, phase_starts_s, phase_ends_s, strict=False):
        colour = "#f2f2f2" if phase.text in (TAKE_OFF, LANDING) else "#c9d9ea"
        draw_block(start_s, end_s, row=_PLAN_ROW, text=phase.text, colour=colour)


def _draw_block(
    band: Axes, left_s: float, right_s: float, *, row: int, text: str, colour: str, total_s: float
) -> None:
    """Draw a coloured block in a row of the band, and its text if it fits."""
    band.fill_between([left_s, right_s], row + 0.06, row + 0.94, color=colour, lw=0)
    # A letter takes about 0.7 % of the width of the figure.
    if right_s - left_s > 0.0068 * len(text) * total_s:
        band.text((left_s + right_s) / 2, row + 0.47, text, ha="center", va="center", fontsize=8.5)


def _draw_events(panels: Sequence[Axes], flight: Flight) -> None:
    """Mark phases, gaps and serious events of a flight in all panels; the last panel has the names of the
    events.
    """
    if not len(flight):
        return
    phases = [event for event in flight.events if event.name == PHASE_EVENT]
    serious_events = [
        event for event in flight.events if event.name in _SERIOUS_EVENTS and not _is_end_of_law(event)
    ]
    for event in phases:
        for panel in panels:
            panel.axvline(_time_in_figure_s(event, flight), color="#666666", lw=0.8, ls=":", zorder=2)
    for row in flight.gaps[:_MAX_GAPS]:
        for panel in panels:
            left_s, right_s = (float(flight.t_s[time_row] - flight.t_s[0]) for time_row in (row, row + 1))
            panel.axvspan(left_s, right_s, color=_GAP_COLOUR, alpha=0.5, lw=0, zorder=1)
    for event in serious_events[:_MAX_EVENTS]:
        for panel in panels:
            panel.axvline(_time_in_figure_s(event, flight), color="#c0202a", lw=1.0, zorder=2)
    for event in _events_with_room(serious_events, flight):
        _draw_label(panels[-1], _time_in_figure_s(event, flight), event.name.replace("_", " "), "#c0202a")


def _is_end_of_law(event: FlightEvent) -> bool:
    """Whether the board's own law took over because a landing or the host ended the flight of a law."""
    return event.name == "law_taken_over" and any(
        f"({reason.name.lower()};" in event.text for reason in (Takeover.COMMAND, Takeover.STATE)
    )


def _draw_label(panel: Axes, at_s: float, text: str, colour: str) -> None:
    """Write a label at the lower end of a panel, at a time [s]."""
    panel.annotate(
        text,
        (at_s, 0.03),
        xycoords=("data", "axes fraction"),
        xytext=(3, 0),
        textcoords="offset points",
        fontsize=8.5,
        color=colour,
        zorder=5,
    )


def _events_with_room(events: Sequence[FlightEvent], flight: Flight) -> list[FlightEvent]:
    """Keep events whose labels do not fall onto each other."""
    spread: list[FlightEvent] = []
    for event in events:
        if not spread or event.t_s - spread[-1].t_s > 0.09 * max(flight.duration_s, 1e-9):
            spread.append(event)
    return spread


def _time_in_figure_s(event: FlightEvent, flight: Flight) -> float:
    return min(max(event.t_s - float(flight.t_s[0]), 0.0), flight.duration_s)


class _StateRun(NamedTuple):
    """Consecutive rows in one state."""

    start: int  # First row
    stop: int  # Row after the last
    state: int  # Number of the state


def _state_runs(state: NDArray[np.uint8]) -> list[_StateRun]:
    """Return the stretches of equal state."""
    edges = np.flatnonzero(np.diff(state)) + 1
    starts = [0, *edges.tolist()]
    stops = [*edges.tolist(), len(state)]
    return [_StateRun(start, stop, int(state[start])) for start, stop in zip(starts, stops, strict=True)]


def _envelope(t_s: NDArray[np.float64], values: NDArray[np.float64]) -> tuple[Any, Any]:
    """Reduce a curve to the minimum and maximum of each bucket, so that a long flight is drawn fast."""
    rows_per_bucket = len(values) // _BUCKETS
    if rows_per_bucket < 3:
        return broken_at_gaps(t_s, values)
    bucket_count = len(values) // rows_per_bucket
    buckets = values[: bucket_count * rows_per_bucket].reshape(bucket_count, rows_per_bucket)
    first_rows = np.arange(bucket_count) * rows_per_bucket
    extreme_rows = np.sort(
        np.column_stack((first_rows + buckets.argmin(axis=1), first_rows + buckets.argmax(axis=1))), axis=1
    ).ravel()
    # Both rows at a gap stay, so that the line ends and begins there.
    gaps = find_gaps(t_s)
    keep = np.unique(np.concatenate((extreme_rows, gaps, gaps + 1, [len(values) - 1])))
    rows_after_gap = np.searchsorted(keep, gaps + 1)
    kept_values = np.asarray(values[keep], np.float64)
    return np.insert(t_s[keep], rows_after_gap, np.nan), np.insert(kept_values, rows_after_gap, np.nan)
