"""A twin as the host knows it: fed with ticks; the entry point ``heli_host.twins``."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Final

import numpy as np
import numpy.typing as npt
from heli_host.arrays import Floats, Integers
from heli_host.link.channels import rad_per_count
from heli_host.link.clock import TICK_S
from heli_host.twins import TwinNews

from heli_lab.errors import TwinError
from heli_lab.twin.files import TwinRig, open_rig
from heli_lab.twin.flights import samples_of_ticks
from heli_lab.twin.kalman_filter import TwinModel
from heli_lab.twin.twin import Twin

_WAITS: Final = "The twin waits for free flight."
_FOLLOWS: Final = "The twin flies along: the rig is the rig."


class TickTwin:
    """A `twin` that takes ticks; `count_rad`, shape (3,), is one count of each encoder."""

    def __init__(self, twin: Twin, count_rad: Floats) -> None:
        self._twin, self._count_rad = twin, count_rad
        self._said = ""

    def take(self, tick: Integers, raw: npt.NDArray[np.int32]) -> list[TwinNews]:
        """Take times `tick`, (n,), and `raw` numbers, (n, channels), in, and say what there is to say."""
        alarm = self._twin.take(samples_of_ticks(tick, raw, self._count_rad))
        for event in alarm:
            self._said = event.text if event.ranking else "" if event.kind == "free" else self._said
        return [TwinNews(event.kind, round(event.t_s / TICK_S), event.text) for event in alarm]

    def ghost_rad(self) -> tuple[float, float, float] | None:
        """Elevation, pitch and travel of the ghost."""
        ghost = self._twin.ghost_rad
        return None if ghost is None else (float(ghost[0]), float(ghost[1]), float(ghost[2]))

    def words(self) -> str:
        """What it does or has found."""
        if self._said:
            return f"The rig and its twin {self._said}"
        return _FOLLOWS if self._twin.free else _WAITS


def open_twin(name: str) -> Callable[[Mapping[str, float], float], TickTwin]:
    """Read a rig, and return what makes its twin for a board's parameters and the hours of free flight in
    which one false alarm is allowed; that raises a TwinError where the board does not say how many counts
    its encoders have.

    Parameters
    ----------
    name : str
        Name of a rig, path of its file, or of a twin's file.

    Raises
    ------
    SimError
        Rig or file are unknown or wrong.
    """
    return partial(_beside, open_rig(name))


def _beside(chosen: TwinRig, parameters: Mapping[str, float], hours: float) -> TickTwin:
    count_rad = rad_per_count(parameters)
    if not np.all(np.isfinite(count_rad)):
        raise TwinError("the board does not say how many counts its encoders have", "set *_counts_per_rev")
    model = TwinModel(chosen.model, chosen.rig)
    twin = Twin(model, chosen.calibration, count_rad, TICK_S, hours, with_ghost=True)
    return TickTwin(twin, count_rad)
