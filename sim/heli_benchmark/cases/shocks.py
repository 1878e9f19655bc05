"""Shocks: in one or both flights of a case, the counterweight slips at some moment.

Each seed gives twelve cases: slips of 10 and 30 mm, with and without disturbances, in three layouts of the
flights. Seeds 5000 to 5099 are for development; 6000 to 6099 judge.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from typing_extensions import override

from heli_benchmark.cases.disturbed import PAPER_RIG, RATES_Hz
from heli_benchmark.cases.disturbed_case import DisturbedCase
from heli_benchmark.effects.disturbances import CORRELATION_TIMES_s, DisturbanceModel, STRENGTHS_Nm
from heli_benchmark.engine.plant import HiddenEffect, Moment
from heli_benchmark.simulation.tracking import CONTROLLERS

SHOCK_LAYOUTS: Final = ("fit", "both", "second")
"""The slip happens in the fitted flight alone; in the fitted and the validation flight, at different moments;
or in the second of two fitted flights, without a validation flight."""
SLIPS_m: Final = (0.01, 0.03)
UNDISTURBED: Final = DisturbanceModel((0.0, 0.0, 0.0), 0.6)
SLIP_EFFECT: Final = "counterweight_shift"


class Slip(HiddenEffect):
    """The counterweight slips outwards by `size` in m at `at_s`, or never if that is infinite."""

    def __init__(self, size: float, at_s: float) -> None:
        super().__init__(size, np.random.default_rng(0))
        self._at_s, self._slipped = at_s, False

    @override
    def during(self, at: Moment, model: Any) -> None:
        if at.flight_s >= self._at_s and not self._slipped:
            model.body("counterweight").pos[0] -= self.size
            self._slipped = True


@dataclass(frozen=True)
class ShockCase(DisturbedCase):
    """A slip of the counterweight on a rig of slightly different parameters."""

    slip_m: float = 0.0  # Distance of the slip outwards
    layout: str = "fit"  # Flights in which the slip happens, of `SHOCK_LAYOUTS`

    @property
    def moments_s(self) -> tuple[float, float]:
        """Moment of the slip in the first and in the second flight; infinite if it does not slip there."""
        second_s = float(np.random.default_rng([self.seed, 11]).uniform(12.0, 26.0))
        return {"fit": (30.0, np.inf), "both": (30.0, second_s), "second": (np.inf, second_s)}[self.layout]

    @override
    def hidden(self, flight: int = 0) -> list[HiddenEffect]:
        return [Slip(self.slip_m, self.moments_s[flight]), *super().hidden(flight)]


def shock_cases(seed: int) -> Iterator[ShockCase]:
    """Draw the twelve cases of a `seed`."""
    for number, (slip_m, disturbed, layout) in enumerate(
        itertools.product(SLIPS_m, (False, True), SHOCK_LAYOUTS)
    ):
        rng = np.random.default_rng([seed, number])
        gusts, correlation_time_s = (
            STRENGTHS_Nm[int(rng.integers(3))],
            CORRELATION_TIMES_s[int(rng.integers(3))],
        )
        yield ShockCase(
            name=f"slip-{1e3 * slip_m:.0f}mm-{'disturbed' if disturbed else 'calm'}-{layout}-{seed}",
            effects=(),
            unlisted=(),
            seed=100 * seed + number,
            makers=(),
            rig_name=PAPER_RIG,
            rate_Hz=RATES_Hz[int(rng.integers(3))],
            gentle=False,
            controller=CONTROLLERS[int(rng.integers(3))],
            disturbances=DisturbanceModel(gusts, correlation_time_s) if disturbed else UNDISTURBED,
            slip_m=slip_m,
            layout=layout,
        )
