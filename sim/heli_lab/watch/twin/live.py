"""The twin's interface to the host, which passes it ticks: the entry point ``heli_host.twins``."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Final

import numpy as np
import numpy.typing as npt
from heli_host.board.twins import TwinNews
from heli_host.data.arrays import Floats, Integers
from heli_host.link.channels import rad_per_count
from heli_host.link.clock import TICK_S

from heli_lab.errors import TwinError
from heli_lab.watch.twin.files import TwinRig, open_rig
from heli_lab.watch.twin.flights import samples_of_ticks
from heli_lab.watch.twin.twin import Twin
from heli_lab.watch.twin.twin_model import TwinModel

_WAITS: Final = "The twin waits for free flight."
_COMPARES: Final = "The twin compares: no change of the rig."
_DOES_NOT_JUDGE: Final = "The twin does not judge these voltages, because no nominal flight has them."


class TickTwin:
    """A `twin` that takes ticks of a board; `count_rad`, shape (3,), is the angle of one count of each
    encoder [rad].
    """

    def __init__(self, twin: Twin, count_rad: Floats) -> None:
        self._twin, self._count_rad = twin, count_rad
        self._alarm_text = ""

    def update(self, tick: Integers, raw: npt.NDArray[np.int32]) -> list[TwinNews]:
        """Process raw numbers `raw`, (n, channels), at the ticks `tick`, (n,), and return the messages that
        they cause.
        """
        events = self._twin.update(samples_of_ticks(tick, raw, self._count_rad))
        for event in events:
            if event.ranking or event.kind == "contradicts":
                self._alarm_text = event.text
            elif event.kind == "free":
                self._alarm_text = ""
        return [TwinNews(event.kind, round(event.t_s / TICK_S), event.text) for event in events]

    def ghost_rad(self) -> tuple[float, float, float] | None:
        """Elevation, pitch and travel of the ghost [rad]; None if there is none."""
        ghost = self._twin.ghost_rad
        return None if ghost is None else (float(ghost[0]), float(ghost[1]), float(ghost[2]))

    def words(self) -> str:
        """Return the twin's status in one line: the newest alarm or contradiction, or whether it compares,
        does not judge or waits.
        """
        if self._alarm_text:
            return f"Twin: {self._alarm_text}"
        if not self._twin.free:
            return _WAITS
        return _COMPARES if self._twin.judges else _DOES_NOT_JUDGE


def open_twin(name: str) -> Callable[[Mapping[str, float], float], TickTwin]:
    """Read a rig, and return a function that makes its twin.

    The function takes the board's parameters and the mean time between two false alarms [h]. It raises a
    TwinError if the parameters do not give the counts of the encoders.
    """
    return partial(_make_twin, open_rig(name))


def _make_twin(twin_rig: TwinRig, parameters: Mapping[str, float], false_alarm_interval_h: float) -> TickTwin:
    """Return the twin of a board with these parameters."""
    count_rad = rad_per_count(parameters)
    if not np.all(np.isfinite(count_rad)):
        raise TwinError(
            "the board does not report the counts per turn of its encoders",
            "set elevation_counts_per_rev, pitch_counts_per_rev and travel_counts_per_rev on the board",
        )
    model = TwinModel(twin_rig.model, twin_rig.rig, twin_rig.calibration.uncertainty)
    twin = Twin(model, twin_rig.calibration, count_rad, TICK_S, false_alarm_interval_h, with_ghost=True)
    return TickTwin(twin, count_rad)
