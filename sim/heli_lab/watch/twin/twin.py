"""The twin of a rig: detects from the samples of a flight that the rig has changed, and ranks the causes."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import ClassVar

import numpy as np
from heli_host.data.arrays import Floats

from heli_lab.fit.linearised_flight import BLOCK_s
from heli_lab.watch.twin.angle_history import AngleHistory
from heli_lab.watch.twin.calibration import Calibration
from heli_lab.watch.twin.events import TwinEvent, contradiction_event, ranked_event
from heli_lab.watch.twin.free_flight import FreeFlight
from heli_lab.watch.twin.ghost import Ghost
from heli_lab.watch.twin.glitches import GlitchWatch, WithoutEncoder
from heli_lab.watch.twin.input_history import BlockEnd, InputHistory
from heli_lab.watch.twin.kalman_filter import KalmanFilter
from heli_lab.watch.twin.likelihood_ratio import RECENT, WINDOW_BLOCKS, Innovation, LikelihoodRatio
from heli_lab.watch.twin.model_check import MIN_SCALE_ERROR, CALIBRATION_s, FILTER_SETTLING_s, ModelCheck
from heli_lab.watch.twin.persistence import CUT_OFF_STD, DIAGNOSIS_DELAY_s, PersistentEvidence
from heli_lab.watch.twin.samples import Samples, Step, Stepper
from heli_lab.watch.twin.twin_model import TwinModel, start_state
from heli_lab.watch.twin.voltage_range import VoltageRange

_FilterPair = WithoutEncoder[KalmanFilter]


class _FilteredFlight:
    """Filter of a flight and its likelihood ratio.

    While an encoder may return from a jump, a second filter with its own likelihood ratio runs without that
    encoder.
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


class Twin(_FilteredFlight):
    """Compares a flight with a model of the rig and raises an alarm when the rig changes.

    Parameters
    ----------
    model : TwinModel
        Equations of the rig with the derivatives by possible changes.
    calibration : Calibration
        Disturbances of the rig and tail of the evidence, which sets the alarm threshold.
    count_rad : ndarray (3,)
        Angle of one count of each encoder [rad].
    sample_s : float
        Time between two successive numbers of the samples [s].
    false_alarm_interval_h : float
        Mean time of free flight between two false alarms [h].
    zero_s : float
        Time on the clock of the samples that events count as 0 s [s].
    with_ghost : bool
        True also simulates a ghost for the page; no alarm depends on it.

    Attributes
    ----------
    evidence_nats : float
        Log-likelihood ratio of the most likely change against no change [nats]: the smallest of the last
        `PERSISTENCE_BLOCKS` measurements; -inf at the beginning and while the twin waits.
    threshold_nats : float
        Evidence above which an alarm is raised [nats].
    free : bool
        True while the twin compares; False while it waits for free flight.
    contradicts : bool
        True if this flight contradicted the model from the start; the twin then names no change of it.
    unjudged_blocks : int
        Number of measurements without evidence, because of voltages that the nominal flights do not contain.
    evidence_history : list of (float, float)
        Time [s] and evidence [nats] of each measurement, recorded if `records_evidence` is set.
    """

    def __init__(
        self,
        model: TwinModel,
        calibration: Calibration,
        count_rad: Floats,
        sample_s: float,
        false_alarm_interval_h: float = 10.0,
        *,
        zero_s: float = 0.0,
        with_ghost: bool = False,
    ) -> None:
        self.model, self.calibration = model, calibration
        self.threshold_nats = calibration.threshold_nats(false_alarm_interval_h)
        self.evidence_nats = -math.inf
        self.free, self.contradicts, self.records_evidence = False, False, False
        self.unjudged_blocks = 0
        self.evidence_history: list[tuple[float, float]] = []
        self._count_rad, self._zero_s = count_rad, zero_s
        self._stepper = Stepper(sample_s)
        self.step_s = self._stepper.step_s
        # Onsets of the window, which stays fixed from an alarm until the final ranking.
        history_blocks = WINDOW_BLOCKS + math.ceil(DIAGNOSIS_DELAY_s / BLOCK_s) + 1
        super().__init__(model, count_rad, self.step_s, history_blocks)
        self._free_flight = FreeFlight(model.rig, self.step_s)
        self._ghost = Ghost(model, self.step_s) if with_ghost else None
        self._inputs = InputHistory(model, self.step_s)
        self._ratio = self._new_ratio()
        # First step of the comparison, and block of the latest alarm, counted from that step.
        self._first_step = 0
        self._alarm_block: int | None = None
        # Whether that alarm has its final ranking, and whether it came during the calibration.
        self._is_diagnosed, self._is_early = False, False
        # Whether the filter has restarted after an alarm.
        self._is_changed = False
        self._model_check = ModelCheck()

    @property
    def ghost_rad(self) -> Floats | None:
        """Angles [rad], (3,), that an open-loop simulation of two seconds predicts; None if there is none."""
        return self._ghost.angles_rad if self._ghost is not None and self._kalman is not None else None

    def standard_error(self, change: str, onset_s: float) -> float | None:
        """Return the standard error of the first parameter of a change, SI; None while the twin waits.

        Parameters
        ----------
        change : str
            Id of the change.
        onset_s : float
            Time at which the change began.
        """
        if self._kalman is None:
            return None
        onset_block = ((onset_s + self._zero_s) / self.step_s - self._first_step) / self._steps_per_block
        return self._ratio.standard_error(change, onset_block)

    def update(self, samples: Samples) -> list[TwinEvent]:
        """Process samples and return the events that they cause. The events do not depend on how the samples
        are split over calls.
        """
        return [event for step in self._stepper.update(samples) for event in self._update_step(step)]

    def finish(self) -> list[TwinEvent]:
        """End the flight and return the final ranking of an alarm that has none yet."""
        return list(self._final_ranking(self._first_step + self._block_count * self._steps_per_block))

    def _update_step(self, step: Step) -> Iterator[TwinEvent]:
        """Process a step: wait for free flight, begin to filter, use a measurement at the end of a block of
        steps, and predict to the next step.
        """
        if step.after_gap:
            yield from self._stop_comparison(step.index, "samples are missing")
            self._inputs.restart()
        t_s = step.index * self.step_s - self._zero_s
        self._step = step.index
        inputs = self._inputs
        inputs.update(step, t_s)
        motor_time_s, acting_V = inputs.motor_time_s, inputs.acting_V
        is_free = self._free_flight.update(step.measured_rad, step.flying)
        if step.measured_rad is not None:
            inputs.remember(step.measured_rad)
        elif self._kalman is None:
            inputs.forget_motion()
        # In a landing the motors run at the border of their dead zone, where evidence is unreliable. An alarm
        # that was raised before the landing still gets its final ranking.
        if not is_free or (step.landing and (self._alarm_block is None or self._is_diagnosed)):
            yield from self._stop_comparison(step.index, "landing, on the table, at a stop, or motors off")
            return
        if reason := self._range.update(step.index, acting_V):
            yield TwinEvent("unjudged", t_s, reason)
        kalman = self._kalman
        if kalman is None:
            if step.measured_rad is None:
                return
            kalman = self._begin_comparison(step.index)
            yield TwinEvent("free", t_s, "the comparison with the model begins")
        elif (step.index - self._first_step) % self._steps_per_block == 0:
            yield from self._end_block(kalman, BlockEnd(step, motor_time_s, acting_V))
            assert self._kalman is not None
            kalman = self._kalman
        if self._ghost is not None:
            zero_rad = kalman.zero_rad
            self._ghost.step(motor_time_s, acting_V, kalman.state, kalman.steady_torque_Nm, zero_rad)
        for filter_, _ in self._filters():
            filter_.predict(motor_time_s, acting_V)

    def _new_ratio(self) -> LikelihoodRatio:
        # The first draw, with outliers cut off, raises alarms; the second, as measured, ranks the changes.
        return LikelihoodRatio(self.model.changes, self._count_rad, draws=2)

    def _begin_comparison(self, index: int) -> KalmanFilter:
        """Begin to filter from the motion before the step `index`."""
        motion = self._inputs.initial_motion()
        self.free = True
        self.contradicts = False
        if self._ghost is not None:
            self._ghost.begin()
        state = start_state(self.model, motion.times_s, motion.angles_rad, motion.volts_V, self.step_s)
        return self._restart(index, state, changed=False)

    def _restart(self, index: int, state: Floats, *, changed: bool) -> KalmanFilter:
        """Restart the filter from a state at the step `index`.

        After an alarm (`changed`), each possible change is an unknown constant of the flight.
        """
        disturbances, steps = self.calibration.disturbances, self._steps_per_block
        self._kalman = KalmanFilter(
            self.model, disturbances, self._count_rad, self.step_s, steps, state, is_changed=changed
        )
        self._ratio = self._new_ratio()
        self._persistent.clear()
        self._first_step, self._block_count = index, 0
        self._alarm_block, self._is_diagnosed, self._is_changed = None, False, changed
        self._model_check, self._glitches = ModelCheck(), GlitchWatch(self._count_rad)
        return self._kalman

    def _end_block(self, kalman: KalmanFilter, block_end: BlockEnd) -> Iterator[TwinEvent]:
        """Compare the measurement with the prediction, raise alarms, and add an onset."""
        self._block_count += 1
        block, step = self._block_count, block_end.step
        t_s = step.index * self.step_s - self._zero_s
        before = self._process_measurement(kalman, block_end)
        if self.watches_glitches and step.measured_rad is not None:
            self._glitches.begin_jump(kalman, before)
        if self._encoder_returned(block_end):
            yield self._continue_without_glitch(t_s)
        if self.records_evidence:
            self.evidence_history.append((t_s, self.evidence_nats))
        if self._alarm_block is None:
            yield from self._raise_alarm(t_s)
        elif (block - self._alarm_block) * self.block_s >= DIAGNOSIS_DELAY_s:
            yield from self._final_ranking(step.index)
            if not self.contradicts:
                assert self._kalman is not None
                self._restart(step.index, self._kalman.state, changed=True)
            return
        # A sudden change raises the alarm before its true onset is in the window. Onsets are therefore added
        # for half a second after an alarm. Then the window stays fixed until the final ranking.
        adds_onsets = self._alarm_block is None or block - self._alarm_block < RECENT
        if adds_onsets and block * self.block_s >= FILTER_SETTLING_s:
            for filter_, ratio in self._filters():
                ratio.begin_onset(block, filter_.state_sensitivity)

    def _raise_alarm(self, t_s: float) -> Iterator[TwinEvent]:
        """Raise an alarm if the evidence is above the threshold.

        At the beginning of a flight, the model itself may be wrong. An alarm in that time is reported only
        with its final ranking.
        """
        block = self._block_count
        is_early = not self._is_changed and block * self.block_s <= CALIBRATION_s
        if is_early:
            yield from self._check_model_once(block, t_s)
        may_be_glitch = self._glitches.alternative is not None
        if self.evidence_nats > self.threshold_nats and not self.contradicts and not may_be_glitch:
            self._alarm_block, self._is_early = block, is_early
            if not is_early:
                yield self._event_with_ranking("alarm", t_s)

    def _process_measurement(self, kalman: KalmanFilter, block_end: BlockEnd) -> _FilterPair | None:
        """Update the filter with a measurement, and the evidence with its innovation.

        Returns copies of filter and ratio before that measurement; None if no jump of an encoder can begin.
        """
        watches = self.watches_glitches and block_end.step.measured_rad is not None
        before = self._glitches.copies(kalman, self._ratio) if watches else None
        innovation = self._use_measurement(kalman, self._ratio, block_end)
        if innovation is not None:
            if not self.judges:
                self.unjudged_blocks += 1
            elif self._block_count * self.block_s > FILTER_SETTLING_s:
                self._model_check.add(innovation.value)
            self._update_evidence(innovation)
        self._angles.remember(self._block_count, kalman.state[:3])
        return before

    def _block_end_s(self, block: int) -> float:
        """Time of the measurement at the end of a `block` [s]."""
        return (self._first_step + block * self._steps_per_block) * self.step_s - self._zero_s

    def _update_evidence(self, innovation: Innovation) -> None:
        """Add an innovation to the evidence.

        The evidence counts only as far as it persists: the smallest of the latest `PERSISTENCE_BLOCKS`
        measurements. It stays unchanged while an encoder may still return from a jump.
        """
        persistent_nats = self._persistent.add(self._ratio.update_cut(innovation, CUT_OFF_STD))
        if self._glitches.alternative is None:
            self.evidence_nats = persistent_nats

    def _check_model_once(self, block: int, t_s: float) -> Iterator[TwinEvent]:
        """Report once, at the end of `CALIBRATION_s`, if the innovations are larger than the model states."""
        is_due = block == math.floor(CALIBRATION_s / self.block_s)
        can_raise_alarms = self.threshold_nats != math.inf
        if is_due and can_raise_alarms and (reason := self._model_check.contradiction()):
            yield self._contradict(t_s, reason)

    def _contradict(self, t_s: float, reason: str) -> TwinEvent:
        """Stop naming changes, because the flight contradicts the model; return the event with the reason."""
        self.contradicts = True
        self._alarm_block = None
        return contradiction_event(t_s, CALIBRATION_s, reason)

    def _stop_comparison(self, index: int, reason: str) -> Iterator[TwinEvent]:
        """Rank an open alarm, and stop the comparison."""
        if self._kalman is None:
            return
        yield from self._final_ranking(index)
        self._kalman = None
        self.free = False
        self.evidence_nats = -math.inf
        yield TwinEvent("waits", index * self.step_s - self._zero_s, f"the comparison stops: {reason}")

    def _final_ranking(self, index: int) -> Iterator[TwinEvent]:
        """Yield the final ranking of an alarm that has none yet.

        If an early alarm is not a wrong encoder scale, the flight contradicts the model instead.
        """
        if self._alarm_block is None or self._is_diagnosed:
            return
        t_s = index * self.step_s - self._zero_s
        if self._is_early:
            most_likely = self._ratio.ranking()[0]
            if not most_likely.change.is_scale or abs(most_likely.size) < MIN_SCALE_ERROR:
                yield self._contradict(
                    t_s, f"the flight contradicts the rig by {self.evidence_nats:.0f} nats"
                )
                return
            yield self._event_with_ranking("alarm", t_s)
        self._is_diagnosed = True
        yield self._event_with_ranking("diagnosed", t_s)

    def _event_with_ranking(self, kind: str, t_s: float) -> TwinEvent:
        """Return an event with the present ranking of the changes."""
        ranking = tuple(self._ratio.ranking())
        onset_s, alarm_s = map(self._block_end_s, (ranking[0].onset_block, self._alarm_block or 0))
        return ranked_event(kind, t_s, alarm_s, ranking, onset_s)
