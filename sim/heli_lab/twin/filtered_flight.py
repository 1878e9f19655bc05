"""Runs the filter of a twin along a flight, with the evidence of changes in its innovations."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from heli_host.arrays import Floats

from heli_lab.estimation import BLOCK_s
from heli_lab.twin.angle_history import AngleHistory
from heli_lab.twin.events import TwinEvent
from heli_lab.twin.glitches import GlitchWatch, WithoutEncoder
from heli_lab.twin.kalman_filter import KalmanFilter
from heli_lab.twin.likelihood_ratio import Innovation, LikelihoodRatio
from heli_lab.twin.persistence import CUT_OFF_STD, PersistentEvidence
from heli_lab.twin.samples import Step
from heli_lab.twin.twin_model import TwinModel
from heli_lab.twin.voltage_range import VoltageRange

FilterPair = WithoutEncoder[KalmanFilter]
"""Filter and evidence of a flight in which one encoder is not used."""


@dataclass(frozen=True)
class BlockEnd:
    """The end of a block of steps, at which the filter uses a measurement.

    Parameters
    ----------
    step : Step
        The step that begins there, with the measured angles.
    motor_time_s : float
        Time since the motors started [s].
    acting_V : ndarray (2,)
        Voltages that act there [V].
    """

    step: Step
    motor_time_s: float
    acting_V: Floats


class FilteredFlight:
    """Filter of a flight and its likelihood ratio.

    While an encoder may return from a jump, a second filter with its own likelihood ratio runs without that
    encoder.

    Parameters
    ----------
    model : TwinModel
        Equations of the rig.
    count_rad : ndarray (3,)
        Angle of one count of each encoder [rad].
    step_s : float
        Length of a step [s].
    history_blocks : int
        Greatest age of an onset, in blocks.
    """

    watches_glitches: ClassVar = True
    """False: an encoder that jumps and returns is evidence of a change."""

    def __init__(self, model: TwinModel, count_rad: Floats, step_s: float, history_blocks: int) -> None:
        self._kalman: KalmanFilter | None = None
        self._ratio = LikelihoodRatio(model.changes, count_rad, draws=2)
        self._persistent = PersistentEvidence()
        self._glitches: GlitchWatch[KalmanFilter] = GlitchWatch(count_rad)
        self._angles = AngleHistory(history_blocks, model.scales)
        self._range, self._step = VoltageRange(model.uncertainty, step_s), 0
        self._block_count, self._steps_per_block = 0, max(1, round(BLOCK_s / step_s))
        self.block_s = self._steps_per_block * step_s

    @property
    def judges(self) -> bool:
        """False while measurements are ignored, after voltages that the nominal flights do not contain."""
        return self._range.is_known(self._step)

    def _use_measurement(
        self, kalman: KalmanFilter, ratio: LikelihoodRatio, block_end: BlockEnd
    ) -> Innovation | None:
        """Update a filter with a measurement; return its innovation, None without a measurement.

        The innovation and its sensitivity are zero after voltages that the nominal flights do not contain, so
        that the evidence stays.
        """
        ages_s = ratio.ages(self._block_count) * self.block_s
        kalman.propagate_sensitivity(ages_s, ratio.is_ramp)
        step = block_end.step
        if step.measured_rad is None:
            return None
        innovation = kalman.update(
            block_end.motor_time_s,
            step.measured_rad,
            step.samples,
            block_end.acting_V,
            amount=np.where(ages_s > 0.0, 1.0, 0.0),
            onset_rad=self._angles.at_onsets(ratio),
        )
        if self.judges:
            return innovation
        return Innovation(np.zeros(3), np.zeros_like(innovation.sensitivity))

    def _begin_possible_jump(
        self, kalman: KalmanFilter, before: FilterPair | None, block_end: BlockEnd
    ) -> None:
        """Begin to run the copies `before` a measurement as the second filter if an encoder jumped."""
        if block_end.step.measured_rad is not None and self.watches_glitches:
            self._glitches.begin_jump(kalman, before)

    def _encoder_returned(self, block_end: BlockEnd) -> bool:
        """Update the second filter if it runs; return whether the encoder has returned to its prediction."""
        second = self._glitches.alternative
        if second is None:
            return False
        innovation = self._use_measurement(second.kalman, second.ratio, block_end)
        if innovation is None:
            return False
        second.ratio.update_cut(innovation, CUT_OFF_STD)
        return self._glitches.decide_return()

    def _continue_without_glitch(self, t_s: float) -> TwinEvent:
        """Replace the filter by the one without the jump, and return the event that describes the jump."""
        second, text = self._glitches.end_jump(t_s, self.block_s)
        self._kalman, self._ratio = second.kalman, second.ratio
        self._persistent.clear()
        return TwinEvent("glitch", t_s, text)

    def _filters(self) -> Iterator[tuple[KalmanFilter, LikelihoodRatio]]:
        """Yield the filter and, while an encoder may return from a jump, the second filter."""
        if self._kalman is not None:
            yield self._kalman, self._ratio
        if (second := self._glitches.alternative) is not None:
            yield second.kalman, second.ratio
