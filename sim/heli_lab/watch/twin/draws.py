"""Draws evidence along a healthy flight: from its own innovations in another order, with random signs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt
from heli_host.data.arrays import Floats
from heli_host.data.flight import Flight
from typing_extensions import override

from heli_lab.fit.grey_box import DisturbanceModel
from heli_lab.watch.twin.calibration import Calibration
from heli_lab.watch.twin.flights import count_rad_of, samples_of
from heli_lab.watch.twin.likelihood_ratio import Innovation, LikelihoodRatio, WINDOW_s
from heli_lab.watch.twin.persistence import CUT_OFF_STD, PERSISTENCE_BLOCKS
from heli_lab.watch.twin.tail import Tail
from heli_lab.watch.twin.twin import Twin
from heli_lab.watch.twin.twin_model import TwinModel

PIECE: Final = 25
"""Length of the pieces of innovations, in measurements: 1 s. Longer: few different draws from half a minute
of flight. Shorter: the innovations lose the dependence that a model with small errors leaves in them."""
_DAY_STD: Final = 0.1
"""Standard deviation of the logarithm of the size of a day's innovations. By judgement: half a minute of
flight leaves it open to 0.05, and days differ. Each draw is a day. Larger: weak changes stay hidden.
Smaller: a day with slightly larger gusts raises alarms."""
NO_ALARM: Final = Tail(np.inf, 0.0, 0.0, 1)
"""Tail of a twin that raises no alarm."""

History = list[tuple[float, float]]
"""Time [s] and evidence [nats] of each measurement of a flight."""


class Draws:
    """Innovations of healthy flights in another order: pieces from random places, with random signs.
    `innovations` has shape (n, 3).
    """

    def __init__(self, innovations: Sequence[Floats], count: int, rng: np.random.Generator) -> None:
        self._innovations: Floats = np.vstack([flight[~_near_kicks(flight)] for flight in innovations])
        self._rng, self.count = rng, count
        # For each draw: row of its next innovation, sign of its present piece, (count,), and the scale of its
        # day for each axis, (count, 3).
        self._row, self._sign = np.zeros(count, int), np.ones(count)
        self._scale: Floats = np.exp(_DAY_STD * rng.normal(size=(count, 3)))
        self._rows_left_in_piece = 0

    def next(self) -> Floats:
        """Return the next innovation of each draw, (count, 3)."""
        if not self._rows_left_in_piece:
            self._row = self._rng.integers(len(self._innovations), size=self.count)
            self._sign = self._rng.choice((-1.0, 1.0), size=self.count)
            self._rows_left_in_piece = PIECE
        self._rows_left_in_piece -= 1
        # A piece that reaches the last row continues with the first one.
        measured = self._innovations[self._row % len(self._innovations)]
        self._row = self._row + 1
        return np.asarray(self._scale * self._sign[:, None] * measured)


def _near_kicks(innovations: Floats) -> npt.NDArray[np.bool_]:
    """Whether each row of innovations, (n, 3), is within `PIECE` rows of a kick; False if all rows are."""
    kicks = np.flatnonzero(np.any(np.abs(innovations) > CUT_OFF_STD, axis=1))
    rows = np.arange(len(innovations))
    is_near = np.any(np.abs(rows[:, None] - kicks) <= PIECE, axis=1)
    return is_near if not is_near.all() else np.zeros(len(rows), bool)


class _RecordingTwin(Twin):
    """A twin that keeps its innovations."""

    watches_glitches = False

    def __init__(
        self, model: TwinModel, calibration: Calibration, count_rad: Floats, sample_s: float
    ) -> None:
        super().__init__(model, calibration, count_rad, sample_s)
        self.records_evidence = True
        self.innovations: list[Floats] = []
        self.kicks_s: list[float] = []

    @override
    def _update_evidence(self, innovation: Innovation) -> None:
        """Record the innovation, and add it to the evidence."""
        self.innovations.append(innovation.value)
        if np.any(np.abs(innovation.value) > CUT_OFF_STD):
            self.kicks_s.append(self._block_end_s(self._block_count))
        super()._update_evidence(innovation)


class _DrawnTwin(Twin):
    """A twin that follows a flight and computes the evidence of drawn innovations."""

    watches_glitches = False

    def __init__(
        self, model: TwinModel, calibration: Calibration, count_rad: Floats, sample_s: float, draws: Draws
    ) -> None:
        self._draws = draws  # before the other attributes, because `_new_ratio` needs it
        super().__init__(model, calibration, count_rad, sample_s)
        self.histories: list[History] = [[] for _ in range(draws.count)]

    @override
    def _new_ratio(self) -> LikelihoodRatio:
        # Evidence of each draw, (count,), at the latest measurements.
        self._latest_nats: list[Floats] = []
        return LikelihoodRatio(self.model.changes, self._count_rad, self._draws.count)

    @override
    def _update_evidence(self, innovation: Innovation) -> None:
        """Add the next drawn innovations instead of the measured one, with its sensitivity."""
        drawn = np.clip(self._draws.next(), -CUT_OFF_STD, CUT_OFF_STD)
        evidence_nats = self._ratio.update_draws(drawn, innovation.sensitivity)
        self._latest_nats = [*self._latest_nats[1 - PERSISTENCE_BLOCKS :], evidence_nats]
        if len(self._latest_nats) == PERSISTENCE_BLOCKS:
            persistent_nats = np.min(self._latest_nats, axis=0)
            t_s = self._block_end_s(self._block_count)
            for history, nats in zip(self.histories, persistent_nats, strict=True):
                history.append((t_s, float(nats)))


@dataclass(frozen=True)
class FollowedFlight:
    """A flight that a twin followed without raising an alarm."""

    history: History  # Time [s] and evidence [nats] of each measurement
    innovations: Floats  # (n, 3): Innovations, in standard deviations
    kicks_s: tuple[float, ...]  # Times of innovations above `CUT_OFF_STD` [s]

    def history_without_kicks(self) -> History:
        """Return the history without the times at which a kick is in the window."""
        return [
            (t_s, nats)
            for t_s, nats in self.history
            if not any(kick_s <= t_s <= kick_s + WINDOW_s for kick_s in self.kicks_s)
        ]


def evidence(twin: TwinModel, disturbances: DisturbanceModel, flight: Flight) -> FollowedFlight:
    """Follow a flight without raising an alarm."""
    samples, sample_s = samples_of(flight)
    no_alarm = Calibration(disturbances, NO_ALARM)
    twin_of_flight = _RecordingTwin(twin, no_alarm, count_rad_of(flight, twin.rig), sample_s)
    twin_of_flight.update(samples)
    innovations = np.array(twin_of_flight.innovations).reshape(-1, 3)
    return FollowedFlight(twin_of_flight.evidence_history, innovations, tuple(twin_of_flight.kicks_s))


def drawn_evidence(
    twin: TwinModel, disturbances: DisturbanceModel, flight: Flight, draws: Draws
) -> list[History]:
    """Return the times [s] and the evidence [nats] of each draw along a flight."""
    samples, sample_s = samples_of(flight)
    no_alarm = Calibration(disturbances, NO_ALARM)
    twin_of_flight = _DrawnTwin(twin, no_alarm, count_rad_of(flight, twin.rig), sample_s, draws)
    twin_of_flight.update(samples)
    return twin_of_flight.histories
