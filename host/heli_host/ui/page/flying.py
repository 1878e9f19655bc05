"""One flight of plans that a page has requested, recorded in a log that is already open."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from heli_host.declaration import AXES
from heli_host.fly.pilot import Pilot, Progress
from heli_host.fly.plan import Plan, take_off
from heli_host.fly.tracking import Tolerance

if TYPE_CHECKING:
    from heli_host.fly.heli import Heli
    from heli_host.fly.recorder import Recorder


class PlanFlight:
    """Plans that were checked against a board and can be flown once."""

    def __init__(
        self, heli: Heli, plans: Sequence[Plan], on_taken_off: Callable[[], object] | None = None
    ) -> None:
        sample = heli.latest
        start_deg = np.degrees([getattr(sample, f"{axis}_rad") for axis in AXES])
        self._heli, self._plans, self._on_taken_off = heli, plans, on_taken_off
        self._route = take_off(plans, dict(heli.params), start_deg)
        self.duration_s = self._route.duration_s
        self.outcome = "not flown"
        self.progress: dict[str, Any] = {"phase": "take-off", "t_s": 0.0, "left_s": self.duration_s}

    def fly(self, recorder: Recorder) -> str:
        """Take off, fly the plans, land, and return the outcome. Blocks until the motors are off."""
        tolerance = Tolerance.widest([plan.tolerance for plan in self._plans])
        pilot = Pilot(
            self._heli,
            self._route,
            self._plans[0].axes,
            recorder,
            self._store_progress,
            tolerance,
            on_taken_off=self._on_taken_off,
        )
        try:
            pilot.fly()
        finally:
            self.outcome = pilot.outcome
        return self.outcome

    def _store_progress(self, progress: Progress) -> None:
        left_s = None if progress.left_s is None else round(max(progress.left_s, 0.0), 1)
        self.progress = {"phase": progress.phase, "t_s": round(progress.t_s, 1), "left_s": left_s}
