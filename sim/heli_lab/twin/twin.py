"""The twin of a rig: takes its samples in, and says when the rig is no longer the rig, and what changed."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from heli_host.arrays import Floats

from heli_lab.estimation import BLOCK_s
from heli_lab.twin.calibration import Calibration
from heli_lab.twin.free_flight import FreeFlight
from heli_lab.twin.ghost import Ghost
from heli_lab.twin.kalman_filter import ZEROS, KalmanFilter, TwinModel, start_state
from heli_lab.twin.likelihood_ratio import RECENT, WINDOW_BLOCKS, ChangeCandidate, LikelihoodRatio
from heli_lab.twin.samples import Samples, Step, Stepper

NAMED_AFTER_s: Final = 3.0
"""Time from the alarm to the last word on what changed, s. Later: surer, and of less use. Earlier: a step
and a fade look alike."""
BEGINS_AFTER_s: Final = 1.0
"""Time that the filter has to find state, zeros and torques before changes are looked for, s."""
_HISTORY_s: Final = 2.0
"""Flight before the filter begins, from which the effects' own states are integrated, s: far longer than any
rotor lags."""
LASTS_BLOCKS: Final = 6
"""Measurements, 40 ms apart, over which evidence has to last before it counts: 0.24 s. Less: a rounding that
a gust makes larger is an alarm. More: what shows at once is told that much later."""
_MANY: Final = 1000.0
"""Times likelier from which on no number is said: such odds hold only if the catalogue has the cause at
all."""


@dataclass(frozen=True)
class TwinEvent:
    """Something that the twin says.

    Parameters
    ----------
    kind : str
        ``free`` when it begins to compare, ``waits`` when it no longer does, ``parted`` at an alarm,
        ``named`` with the last word on what changed.
    t_s : float
        When, on the clock of the samples less its zero.
    text : str
        For a person.
    ranking : tuple of ChangeCandidate
        With ``parted`` and ``named``: what may have changed, the likeliest first.
    onset_s : float
        When the likeliest began; nan for the other kinds.
    """

    kind: str
    t_s: float
    text: str
    ranking: tuple[ChangeCandidate, ...] = ()
    onset_s: float = math.nan


class Twin:
    """Flies beside a rig.

    Parameters
    ----------
    model : TwinModel
        Its equations.
    calibration : Calibration
        Weather, and what is an alarm.
    count_rad : ndarray (3,)
        One count of each encoder.
    sample_s : float
        Time from one number of the samples to the next.
    hours : float
        One false alarm in so many hours of free flight, on average.
    zero_s : float
        What is called 0 s, on the clock of the samples.
    with_ghost : bool
        Whether a ghost flies along, to be drawn; no alarm depends on it.

    Attributes
    ----------
    evidence_nats : float
        Of the likeliest change against none, the least of the last `LASTS_BLOCKS` measurements; -inf while
        nothing is compared, and at the beginning.
    threshold_nats : float
        Evidence that is an alarm.
    free : bool
        Whether it compares now.
    parted : bool
        Whether there was an alarm since the flight was free.
    evidence_history : list of (float, float)
        Times and evidence of every block, where `keeps` is set.
    """

    def __init__(
        self,
        model: TwinModel,
        calibration: Calibration,
        count_rad: Floats,
        sample_s: float,
        hours: float = 10.0,
        *,
        zero_s: float = 0.0,
        with_ghost: bool = False,
    ) -> None:
        self.model, self.calibration = model, calibration
        self.threshold_nats = calibration.threshold_nats(hours)
        self.evidence_nats = -math.inf
        self.free = self.parted = False
        self.keeps = False
        self.evidence_history: list[tuple[float, float]] = []
        self._count_rad, self._zero_s = count_rad, zero_s
        self._stepper = Stepper(sample_s)
        self.step_s = self._stepper.step_s
        self._block = max(1, round(BLOCK_s / self.step_s))
        self.block_s = self._block * self.step_s
        self._free_flight = FreeFlight(model.rig, self.step_s)
        self._ghost = Ghost(model, self.step_s) if with_ghost else None
        self._delayed = round(model.delay_s / self.step_s)
        self._history: deque[tuple[float, Floats, Floats]] = deque(maxlen=round(_HISTORY_s / self.step_s))
        self._volts: deque[Floats] = deque(maxlen=self._delayed + 1)
        self._motors_since_s = math.nan
        self._kalman: KalmanFilter | None = None
        self._ratio = LikelihoodRatio(model.changes, count_rad)
        self._latest_nats: deque[float] = deque([-math.inf] * LASTS_BLOCKS, LASTS_BLOCKS)
        self._angles_rad: Floats = np.zeros((WINDOW_BLOCKS + math.ceil(NAMED_AFTER_s / BLOCK_s) + 1, 3))
        """Angles at the ends of the blocks that an onset may be of, by number modulo its length."""
        self._began = self._blocks = 0
        self._alarm_block: int | None = None
        self._named = False

    @property
    def ghost_rad(self) -> Floats | None:
        """Where the twin is that flew by itself for two seconds, (3,); None where there is none."""
        return self._ghost.angles_rad if self._ghost is not None and self._kalman is not None else None

    def standard_error(self, change: str, onset_s: float) -> float | None:
        """Standard error of the first number of a `change`, by its id, that began at `onset_s`; None where
        nothing is compared.
        """
        if self._kalman is None:
            return None
        return self._ratio.standard_error(
            change, ((onset_s + self._zero_s) / self.step_s - self._began) / self._block
        )

    def take(self, samples: Samples) -> list[TwinEvent]:
        """Take samples in; what it says does not depend on how many come at once."""
        return [event for step in self._stepper.take(samples) for event in self._take_step(step)]

    def finish(self) -> list[TwinEvent]:
        """End: the last word of an alarm that was just given."""
        return list(self._last_word(self._began + self._blocks * self._block))

    def _take_step(self, step: Step) -> Iterator[TwinEvent]:
        if step.begins:
            yield from self._wait(step.index, "samples are missing")
            self._history.clear()
            self._volts.clear()
            self._motors_since_s = math.nan
        t_s = step.index * self.step_s - self._zero_s
        volts_V = np.maximum(step.volts_V, self.model.least_V).mean(axis=0)
        self._volts.append(volts_V)
        acting_V = self._volts[0]
        if not step.flying:
            self._motors_since_s = math.nan
        elif math.isnan(self._motors_since_s) and np.any(step.volts_V):
            self._motors_since_s = t_s
        since_s = 0.0 if math.isnan(self._motors_since_s) else t_s - self._motors_since_s
        free = self._free_flight.take(step.measured_rad, step.flying)
        if step.measured_rad is not None:
            self._history.append((since_s, step.measured_rad, acting_V))
        elif self._kalman is None:
            self._history.clear()
        # In a landing the motors run at the border of their dead zone, where evidence is not to be trusted;
        # what has parted before is named all the same.
        if not free or (step.landing and (self._alarm_block is None or self._named)):
            yield from self._wait(step.index, "landing, on the ground, at a stop, or motors off")
            return
        kalman = self._kalman
        if kalman is None:
            if step.measured_rad is None:
                return
            kalman = self._begin(step.index)
            yield TwinEvent("free", t_s, "the twin flies along")
        elif (step.index - self._began) % self._block == 0:
            yield from self._end_block(kalman, step, since_s, acting_V)
        if self._ghost is not None:
            zero_rad = kalman.mean[-len(ZEROS) :]
            self._ghost.step(since_s, acting_V, kalman.state, kalman.steady_torque_Nm, zero_rad)
        kalman.predict(since_s, acting_V)

    def _begin(self, index: int) -> KalmanFilter:
        times, angles, volts = (np.array(values) for values in zip(*self._history, strict=True))
        state = start_state(self.model, times, angles, volts, self.step_s)
        self._kalman = KalmanFilter(
            self.model, self.calibration.disturbances, self._count_rad, self.step_s, self._block, state
        )
        self._ratio = LikelihoodRatio(self.model.changes, self._count_rad)
        self._latest_nats.extend([-math.inf] * LASTS_BLOCKS)
        self._began, self._blocks = index, 0
        self._alarm_block, self._named, self.parted = None, False, False
        self.free = True
        if self._ghost is not None:
            self._ghost.begin()
        return self._kalman

    def _end_block(
        self, kalman: KalmanFilter, step: Step, since_s: float, volts_V: Floats
    ) -> Iterator[TwinEvent]:
        """Compare what was measured with what was foretold."""
        self._blocks += 1
        ratio, block = self._ratio, self._blocks
        t_s = step.index * self.step_s - self._zero_s
        ages_s = ratio.ages(block) * (self.block_s)
        kalman.move(ages_s, ratio.grows)
        if step.measured_rad is not None:
            amount = np.where(ages_s > 0.0, 1.0, 0.0)
            innovation = kalman.update(
                since_s, step.measured_rad, step.samples, volts_V, amount, self._onset_rad()
            )
            self._latest_nats.append(ratio.take(innovation))
            self.evidence_nats = min(self._latest_nats)
        self._angles_rad[block % len(self._angles_rad)] = kalman.state[:3]
        if self.keeps:
            self.evidence_history.append((t_s, self.evidence_nats))
        if self._alarm_block is None:
            if self.evidence_nats > self.threshold_nats:
                self._alarm_block, self.parted = block, True
                yield self._say("parted", t_s)
        elif (block - self._alarm_block) * self.block_s >= NAMED_AFTER_s:
            yield from self._last_word(step.index)
        # What shows at once is an alarm before it is over: onsets go on for a moment, then the window stands
        # still.
        fresh = self._alarm_block is None or block - self._alarm_block < RECENT
        if fresh and block * self.block_s >= BEGINS_AFTER_s:
            ratio.begin_onset(block, kalman.moved)

    def _onset_rad(self) -> Floats:
        """Angle of its axis at each onset of an encoder's scale, (scales, onsets)."""
        kept = len(self._angles_rad)
        return np.array(
            [
                self._angles_rad[self._ratio.onset_blocks(column) % kept, axis]
                for column, axis in self.model.scales
            ]
        )

    def _wait(self, index: int, why: str) -> Iterator[TwinEvent]:
        if self._kalman is None:
            return
        yield from self._last_word(index)
        self._kalman = None
        self.free = False
        self.evidence_nats = -math.inf
        yield TwinEvent("waits", index * self.step_s - self._zero_s, f"the twin waits: {why}")

    def _last_word(self, index: int) -> Iterator[TwinEvent]:
        if self._alarm_block is not None and not self._named:
            self._named = True
            yield self._say("named", index * self.step_s - self._zero_s)

    def _say(self, kind: str, t_s: float) -> TwinEvent:
        ranking = tuple(self._ratio.ranking())
        onset_s = (self._began + ranking[0].onset_block * self._block) * self.step_s - self._zero_s
        alarm_s = (self._began + (self._alarm_block or 0) * self._block) * self.step_s - self._zero_s
        words = f"parted at {alarm_s:.1f} s. Most like: {said(ranking, onset_s)}."
        return TwinEvent(kind, t_s, words, ranking, onset_s)


def said(ranking: Sequence[ChangeCandidate], onset_s: float) -> str:
    """Say what changed by a `ranking`, since when (`onset_s`, s), and how surely."""
    first, second = ranking[:2]
    odds = math.exp(min(first.log_evidence - second.log_evidence, 50.0))
    times = f"{odds:.0f} times" if odds < _MANY else f"over {_MANY:.0f} times"
    if odds < 1.5:
        rest = f"or as likely {second.change.words(second.size, second.std)}"
    else:
        rest = f"{times} likelier than the next ({second.change.id})"
    return f"{first.change.words(first.size, first.std)} since {onset_s:.1f} s; {rest}"
