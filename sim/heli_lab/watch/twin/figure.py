"""A figure of the evidence over a flight."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from heli_host.data.files import save_figure

if TYPE_CHECKING:
    from heli_lab.watch.twin.monitor import TwinReport


def draw_evidence(flights: Sequence[TwinReport], path: Path) -> None:
    """Draw the evidence of some flights below each other, into a .png, .pdf or .svg file at `path`."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.0, 0.6 + 2.2 * len(flights)), layout="constrained")
    axes = figure.subplots(len(flights), 1, squeeze=False)[:, 0]
    for ax, flight in zip(axes, flights, strict=True):
        t_s, evidence_nats = np.array(flight.evidence_nats, float).reshape(-1, 2).T
        # No line is drawn through times at which the evidence is unknown.
        is_known = np.isfinite(evidence_nats)
        ax.plot(
            t_s,
            np.where(is_known, np.maximum(evidence_nats, 0.0), np.nan),
            color="#0b5394",
            lw=1.2,
            label="most likely change",
        )
        ax.axhline(flight.threshold_nats, color="#b45f06", ls="--", lw=1.0, label="alarm")
        for event in flight.events:
            if event.kind == "alarm":
                ax.axvline(event.t_s, color="#990000", lw=1.0)
        text = "; ".join(flight.sentences())
        ax.set_title(f"{flight.label}: {text}"[:140], fontsize=8, loc="left")
        ax.set_ylabel("evidence, nats")
        ax.legend(loc="upper left", fontsize=7)
    axes[-1].set_xlabel("time, s")
    save_figure(figure, path, dpi=130)
