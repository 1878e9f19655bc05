"""The result of a flight in a few lines, which a verb prints at its end."""

from __future__ import annotations

from typing import TYPE_CHECKING

from heli_host.errors import printable

if TYPE_CHECKING:
    from heli_host.data.log.summary import FlightSummary


def summary_lines(summary: FlightSummary) -> list[str]:
    """Return a few lines with the plans, the outcome, the tracking error and the lost ticks."""
    plans = " + ".join(summary.plans) or "no plan"
    rig = f" on {summary.rig}" if summary.rig else ""
    errors = ", ".join(
        f"{axis} {'not flown' if error is None else f'{error:.2f} deg'}"
        for axis, error in summary.rms_error_deg.items()
    )
    link = summary.link
    lines = [
        f"{plans}{rig}: {summary.outcome}, {summary.duration_s:.1f} s",
        f"tracking error (rms): {errors}",
        f"{summary.ticks_logged} ticks logged, {summary.ticks_lost} lost; {link.get('frames_bad', 0)} bad "
        f"frames, {link.get('retries', 0)} retries, {link.get('reconnects', 0)} reconnects",
        *(f"note: {note}" for note in summary.notes),
        *(f"warning: {finding.text}" for finding in summary.findings),
    ]
    return [printable(line) for line in lines]
