"""The twin of a rig: detects from the samples of a flight that the rig has changed, and ranks the causes."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from heli_host.data.arrays import Floats
from heli_sim.model.effect import AXES

from heli_lab.fit import _kalman
from heli_lab.fit.linearised_flight import BLOCK_s
from heli_lab.watch.calibration import Calibration
from heli_lab.watch.glitches import GlitchWatch
from heli_lab.watch.kalman_filter import KalmanFilter
from heli_lab.watch.likelihood_ratio import (
    CUT_OFF_STD,
    RECENT,
    WINDOW_BLOCKS,
    ChangeCandidate,
    Evidence,
    Innovation,
    LikelihoodRatio,
    PersistentEvidence,
)
from heli_lab.watch.model_check import ModelFit, PieceVariance, compare_with, piece_variance
from heli_lab.watch.steps import FreeFlight, InputHistory, Samples, Step, Stepper, VoltageRange
from heli_lab.watch.twin_model import SCALES, ZEROS, TwinModel, start_state

DIAGNOSIS_DELAY_s: Final = 3.0
"""Time from the alarm to the final ranking of changes, s. Longer: the ranking is more certain but less
useful. Shorter: a step and a fade look alike."""
FILTER_SETTLING_s: Final = 1.0
"""Time for which the filter estimates state, encoder zeros and torques before it looks for changes, s."""
CALIBRATION_s: Final = 8.0
"""Time in which the filter estimates what differs between days, s: supply, encoder zeros, constant torques,
and the parameters within their covariance. `diagnose` uses the same time. A model that is contradicted so
early was wrong from the start. Longer: an early change is not named. Shorter: another day's supply is taken
for a change."""
_MAX_MEAN_SQUARE: Final = 2.0
"""Mean square of an axis' innovations in `CALIBRATION_s` above which the model is not this rig's, whatever
their sums are; 1 is what the model states. 175 innovations with the outliers of real flights (kurtosis 6)
have a standard error of 0.17, so chance needs six of them. Larger: flights that no model here explains
raise alarms later. Smaller: a day with gusts 1.4 times as large contradicts the rig."""
_MAX_CHANGES: Final = 2
"""Number of changes that a flight may have. If a third one seems to begin, the model is wrong: a healthy
measured flight of a machine that the twin had not learned had four alarms in 22 s (2026-11). Larger: a
wrong model names changes for longer. Smaller: a second change, such as the other rotor of a weak supply, is
not named."""
_MIN_SCALE_ERROR: Final = 0.25
"""Error of an encoder's scale that is named even if a flight begins with it: a decoder that counts half the
edges. Larger: such a decoder is not named. Smaller: a model of another day's rig is taken for one."""
_FREE_RUN_s: Final = 2.0
"""Length of the open-loop simulation, s. A rotor that lost 5 % of its thrust moves the ghost by 5 degrees of
pitch in that time, disturbances by 1 degree. Longer: disturbances alone move it away. Shorter: it shows no
difference."""
_RUNS: Final = 10
"""Number of simulations at the same time. More: the ghost moves more smoothly, and takes more time."""
_NOT_THIS_MODEL: Final = "not this model from the start"
_IN_FIRST_SECONDS: Final = f"in the first {CALIBRATION_s:g} s, "
_TOO_MANY_CHANGES: Final = (
    f"not this model: more than {_MAX_CHANGES} changes seem to follow each other in this flight, so the "
    "model does not fit this machine well enough for the accepted rate of false alarms"
)
_MAX_REPORTED_ODDS: Final = 1000.0
"""Odds above which no number is reported: such odds hold only if the catalogue contains the true cause."""
_HISTORY_BLOCKS: Final = WINDOW_BLOCKS + math.ceil(DIAGNOSIS_DELAY_s / BLOCK_s) + 1
"""Number of blocks whose angles are kept: the window, and the time from an alarm until its ranking."""


@dataclass(frozen=True)
class TwinEvent:
    """A message of the twin.

    Parameters
    ----------
    kind : str
        ``free`` when the twin begins to compare, ``waits`` when it pauses, ``alarm`` when the rig has
        changed, ``diagnosed`` with the final ranking. ``fits`` when the first seconds agree with the model,
        ``contradicts`` when they do not, or when too many changes follow each other; no change is then named.
        ``glitch`` when an encoder jumped and returned.
        ``unjudged`` when the flight first leaves the voltages of the nominal flights.
    t_s : float
        Time of the message on the clock of the samples minus its zero [s].
    text : str
        Message for people.
    ranking : tuple of ChangeCandidate
        For ``alarm`` and ``diagnosed``: possible changes, the most likely first.
    onset_s : float
        Time at which the most likely change began [s]; nan for the other kinds.
    """

    kind: str
    t_s: float
    text: str
    ranking: tuple[ChangeCandidate, ...] = ()
    onset_s: float = math.nan


def _format_ranking(ranking: Sequence[ChangeCandidate], onset_s: float) -> str:
    """Describe the first change of a `ranking`, its onset (`onset_s`, s), and its odds against the second."""
    first, second = ranking[:2]
    odds = math.exp(min(first.log_evidence - second.log_evidence, 50.0))
    odds_text = f"{odds:.0f} times" if odds < _MAX_REPORTED_ODDS else f"over {_MAX_REPORTED_ODDS:.0f} times"
    if odds < 1.5:
        second_text = f"equally likely: {second.change.words(second.size, second.std)}"
    else:
        second_text = f"{odds_text} more likely than the next change ({second.change.id})"
    return f"{first.change.words(first.size, first.std)} since {onset_s:.1f} s; {second_text}"


def _is_wrong_decoder(difference: ChangeCandidate) -> bool:
    """Whether a difference with which a flight begins is a wrong scale of an encoder that is named."""
    # A take-off moves elevation only, and a lag of the rotors then looks like a scale of it: lags of 0.05 to
    # 0.15 s like one of 1.8 to 2.2.
    change = difference.change
    is_named = change.is_scale and SCALES[change.parameters[0]] != "elevation"
    return is_named and abs(difference.size) >= _MIN_SCALE_ERROR


class Twin:
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
    evidence : callable, optional
        Called without arguments at the beginning of each comparison; returns what collects the evidence in
        its innovations. By default a `PersistentEvidence`.
    watches_glitches : bool
        False: an encoder that jumps and returns is evidence of a change.

    Attributes
    ----------
    threshold_nats : float
        Evidence above which an alarm is raised [nats].
    contradicts : bool
        True if this flight contradicts the model; the twin then names no change of it.
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
        evidence: Callable[[], Evidence] | None = None,
        watches_glitches: bool = True,
    ) -> None:
        self.model, self.calibration = model, calibration
        self.threshold_nats = calibration.threshold_nats(false_alarm_interval_h)
        self.contradicts, self.records_evidence = False, False
        self.unjudged_blocks = 0
        self.evidence_history: list[tuple[float, float]] = []
        self._count_rad, self._zero_s = count_rad, zero_s
        self._new_evidence = evidence or self._persistent_evidence
        self._watches_glitches = watches_glitches
        self._stepper = Stepper(sample_s)
        self.step_s = self._stepper.step_s
        self._steps_per_block = max(1, round(BLOCK_s / self.step_s))
        self.block_s = self._steps_per_block * self.step_s
        self._step = 0  # Number of the present step
        self._free_flight = FreeFlight(model.rig, self.step_s)
        self._range = VoltageRange(model.uncertainty, self.step_s)
        self._inputs = InputHistory(model, self.step_s)
        self._ghost = _Ghost(model, self.step_s) if with_ghost else None
        self._comparison: _Comparison | None = None
        self._changes = 0  # Number of alarms since the comparison began
        self._latest_nats = -math.inf  # Evidence of the comparison before an alarm's final ranking

    @property
    def free(self) -> bool:
        """True while the twin compares; False while it waits for free flight."""
        return self._comparison is not None

    @property
    def judges(self) -> bool:
        """False while measurements are ignored, after voltages that the nominal flights do not contain."""
        return self._range.is_known(self._step)

    @property
    def evidence_nats(self) -> float:
        """Log-likelihood ratio of the most likely change against no change [nats]: the smallest of the latest
        measurements; -inf at the beginning and while the twin waits.
        """
        comparison = self._comparison
        if comparison is None:
            return -math.inf
        # A new comparison has no evidence before its first measurement: that of the alarm is the latest.
        return comparison.evidence_nats if comparison.block else self._latest_nats

    @property
    def ghost_rad(self) -> Floats | None:
        """Angles [rad], (3,), that an open-loop simulation of two seconds predicts; None if there is none."""
        return self._ghost.angles_rad if self._ghost is not None and self.free else None

    def standard_error(self, change: str, onset_s: float) -> float | None:
        """Return the standard error of the first parameter of a change, SI; None while the twin waits.

        Parameters
        ----------
        change : str
            Id of the change.
        onset_s : float
            Time at which the change began.
        """
        comparison = self._comparison
        if comparison is None:
            return None
        onset_step = (onset_s + self._zero_s) / self.step_s
        onset_block = (onset_step - comparison.first_step) / self._steps_per_block
        return comparison.evidence.ratio.standard_error(change, onset_block)

    def update(self, samples: Samples) -> list[TwinEvent]:
        """Process samples and return the events that they cause. The events do not depend on how the samples
        are split over calls.
        """
        return [event for step in self._stepper.update(samples) for event in self._update_step(step)]

    def finish(self) -> list[TwinEvent]:
        """End the flight and return the final ranking of an alarm that has none yet."""
        comparison = self._comparison
        if comparison is None:
            return []
        return list(self._final_ranking(comparison, self._block_end_s(comparison, comparison.block)))

    def _update_step(self, step: Step) -> Iterator[TwinEvent]:
        """Process a step: wait for free flight, begin to compare, use a measurement at the end of a block of
        steps, and predict to the next step.
        """
        t_s = step.index * self.step_s - self._zero_s
        inputs = self._inputs
        if step.after_gap:
            yield from self._stop_comparison(t_s, "samples are missing")
            inputs.restart()
        self._step = step.index
        inputs.update(step, t_s)
        is_free = self._free_flight.update(step.measured_rad, step.flying)
        if step.measured_rad is not None:
            inputs.remember(step.measured_rad)
        elif self._comparison is None:
            inputs.forget_motion()  # a comparison starts from motion without gaps
        # In a landing the motors run at the border of their dead zone, where evidence is unreliable. An alarm
        # that was raised before the landing still gets its final ranking.
        has_open_alarm = self._comparison is not None and self._comparison.has_open_alarm
        if not is_free or (step.landing and not has_open_alarm):
            yield from self._stop_comparison(t_s, "landing, on the table, at a stop, or motors off")
            return
        if reason := self._range.update(step.index, inputs.acting_V):
            yield TwinEvent("unjudged", t_s, reason)
        if self._comparison is None:
            if step.measured_rad is None:
                return  # a comparison starts from measured angles
            self._begin_comparison(step.index)
            yield TwinEvent("free", t_s, "the comparison with the model begins")
        elif (step.index - self._comparison.first_step) % self._steps_per_block == 0:
            yield from self._end_block(self._comparison, step, t_s)
        # The comparison is a new one after an alarm.
        comparison = self._comparison
        assert comparison is not None
        if self._ghost is not None:
            kalman = comparison.kalman
            self._ghost.step(
                inputs.motor_time_s, inputs.acting_V, kalman.state, kalman.steady_torque_Nm, kalman.zero_rad
            )
        for filter_, _ in comparison.filters():
            filter_.predict(inputs.motor_time_s, inputs.acting_V)

    def _begin_comparison(self, index: int) -> None:
        """Begin to compare at the step `index`, from the motion before it."""
        motion = self._inputs.initial_motion()
        self.contradicts, self._latest_nats, self._changes = False, -math.inf, 0
        if self._ghost is not None:
            self._ghost.begin()
        state = start_state(self.model, motion.times_s, motion.angles_rad, motion.volts_V, self.step_s)
        self._comparison = self._new_comparison(index, state, is_changed=False)

    def _new_comparison(self, index: int, state: Floats, *, is_changed: bool) -> _Comparison:
        """Return a comparison that begins with a state at the step `index`."""
        # After an alarm (`is_changed`), each possible change is an unknown constant of the flight.
        kalman = KalmanFilter(
            self.model,
            self.calibration.disturbances,
            self._count_rad,
            self.step_s,
            self._steps_per_block,
            state,
            is_changed=is_changed,
        )
        return _Comparison(
            kalman,
            self._new_evidence(),
            GlitchWatch(self._count_rad),
            _AngleHistory(self.model.scales),
            index,
            self.block_s,
            is_changed=is_changed,
        )

    def _persistent_evidence(self) -> PersistentEvidence:
        # The first draw, with outliers cut off, raises alarms; the second, as measured, ranks the changes.
        return PersistentEvidence(LikelihoodRatio(self.model.changes, self._count_rad, draws=2))

    def _end_block(self, comparison: _Comparison, step: Step, t_s: float) -> Iterator[TwinEvent]:
        """Compare the measurement with the prediction, raise alarms, and add an onset."""
        is_judged = self.judges
        yield from comparison.update(
            step, self._inputs, t_s, is_judged=is_judged, watches_glitches=self._watches_glitches
        )
        if step.measured_rad is not None and not is_judged:
            self.unjudged_blocks += 1
        if self.records_evidence:
            self.evidence_history.append((t_s, comparison.evidence_nats))
        alarm = comparison.alarm
        if alarm is None:
            yield from self._raise_alarm(comparison, t_s)
        elif (comparison.block - alarm.block) * self.block_s >= DIAGNOSIS_DELAY_s:
            yield from self._final_ranking(comparison, t_s)
            if not self.contradicts:
                self._latest_nats = comparison.evidence_nats
                self._comparison = self._new_comparison(step.index, comparison.kalman.state, is_changed=True)
            return
        comparison.begin_onset()

    def _raise_alarm(self, comparison: _Comparison, t_s: float) -> Iterator[TwinEvent]:
        """Raise an alarm if the evidence is above the threshold."""
        # At the beginning of a flight, the model itself may be wrong. An alarm in that time is reported only
        # with its final ranking.
        is_early = not comparison.is_changed and comparison.age_s <= CALIBRATION_s
        if is_early:
            yield from self._check_model_once(comparison, t_s)
        may_be_glitch = comparison.glitches.alternative is not None
        if comparison.evidence_nats > self.threshold_nats and not self.contradicts and not may_be_glitch:
            if self._changes == _MAX_CHANGES:
                yield self._contradict(comparison, t_s, _TOO_MANY_CHANGES)
                return
            comparison.alarm = _Alarm(comparison.block, is_early)
            self._changes += 1
            if not is_early:
                yield self._ranking_event("alarm", comparison, t_s)

    def _check_model_once(self, comparison: _Comparison, t_s: float) -> Iterator[TwinEvent]:
        """Report once, at the end of `CALIBRATION_s`, whether the innovations agree with the model."""
        is_due = comparison.block == math.floor(CALIBRATION_s / self.block_s)
        can_raise_alarms = self.threshold_nats != math.inf
        # An early alarm decides with its final ranking.
        if not is_due or not can_raise_alarms or self.contradicts or comparison.has_open_alarm:
            return
        model_fit = comparison.model_check.compared_with(self.calibration.piece_variance)
        if reason := comparison.model_check.contradiction(model_fit):
            yield self._contradict(comparison, t_s, f"{_NOT_THIS_MODEL}: {_IN_FIRST_SECONDS}{reason}")
        elif model_fit.is_decided:
            yield TwinEvent(
                "fits",
                t_s,
                f"the model fits: {_IN_FIRST_SECONDS}its errors over 1 s are at most {model_fit.ratio:.1f} "
                f"times as large as expected (chance: up to {model_fit.chance_ratio:.1f})",
            )

    def _contradict(self, comparison: _Comparison, t_s: float, reason: str) -> TwinEvent:
        """Stop naming changes, because the flight contradicts the model; return the event with the reason."""
        self.contradicts = True
        comparison.alarm = None
        return TwinEvent("contradicts", t_s, f"{reason}; no change is named. {self._remedy}")

    @property
    def _remedy(self) -> str:
        """State how the model can be made to fit."""
        if self.calibration.has_learned:
            return "Identify the rig again, and add a flight of this day to --nominal with --learn"
        return "Train the twin on nominal flights of this machine with --nominal and --learn"

    def _stop_comparison(self, t_s: float, reason: str) -> Iterator[TwinEvent]:
        """Rank an open alarm, and stop the comparison."""
        if self._comparison is None:
            return
        yield from self._final_ranking(self._comparison, t_s)
        self._comparison = None
        yield TwinEvent("waits", t_s, f"the comparison stops: {reason}")

    def _final_ranking(self, comparison: _Comparison, t_s: float) -> Iterator[TwinEvent]:
        """Yield the final ranking of an alarm that has none yet."""
        # If an early alarm is not a wrong encoder scale, the flight contradicts the model instead.
        alarm = comparison.alarm
        if alarm is None or alarm.is_diagnosed:
            return
        if alarm.is_early:
            most_likely = comparison.evidence.ratio.ranking(from_start=True)[0]
            if not _is_wrong_decoder(most_likely):
                evidence_text = f"the flight contradicts the rig by {comparison.evidence_nats:.0f} nats"
                yield self._contradict(
                    comparison, t_s, f"{_NOT_THIS_MODEL}: {_IN_FIRST_SECONDS}{evidence_text}"
                )
                return
            yield self._ranking_event("alarm", comparison, t_s)
        alarm.is_diagnosed = True
        yield self._ranking_event("diagnosed", comparison, t_s)

    def _ranking_event(self, kind: str, comparison: _Comparison, t_s: float) -> TwinEvent:
        """Return an event of the alarm of a comparison, with the present ranking of the changes."""
        alarm = comparison.alarm
        is_early = alarm is not None and alarm.is_early
        ranking = tuple(comparison.evidence.ratio.ranking(from_start=is_early))
        alarm_block = 0 if alarm is None else alarm.block
        onset_s = self._block_end_s(comparison, ranking[0].onset_block)
        alarm_s = self._block_end_s(comparison, alarm_block)
        text = f"alarm at {alarm_s:.1f} s. Most likely: {_format_ranking(ranking, onset_s)}."
        return TwinEvent(kind, t_s, text, ranking, onset_s)

    def _block_end_s(self, comparison: _Comparison, block: int) -> float:
        """Time of the measurement at the end of a `block` of a comparison [s]."""
        return (comparison.first_step + block * self._steps_per_block) * self.step_s - self._zero_s


@dataclass
class _Alarm:
    """The alarm of a comparison."""

    block: int  # Number of the measurement that raised it
    is_early: bool  # Whether it was raised during the calibration
    is_diagnosed: bool = False  # Whether it has its final ranking


class _Comparison:
    """A filter from one start to the next, with the evidence of changes in its innovations."""

    # While an encoder may return from a jump, a second filter with its own likelihood ratio runs without that
    # encoder. After an alarm, a new comparison begins.

    def __init__(
        self,
        kalman: KalmanFilter,
        evidence: Evidence,
        glitches: GlitchWatch[KalmanFilter],
        angles: _AngleHistory,
        first_step: int,
        block_s: float,
        *,
        is_changed: bool,
    ) -> None:
        self.kalman, self.evidence, self.glitches = kalman, evidence, glitches
        self.first_step, self.is_changed = first_step, is_changed
        self.block = 0  # Number of measurements since the first step
        self.alarm: _Alarm | None = None
        self.evidence_nats = -math.inf
        self.model_check = _ModelCheck()
        self._angles, self._block_s = angles, block_s

    @property
    def age_s(self) -> float:
        """Time since the first step [s]."""
        return self.block * self._block_s

    @property
    def has_open_alarm(self) -> bool:
        """Whether there is an alarm without its final ranking."""
        return self.alarm is not None and not self.alarm.is_diagnosed

    def filters(self) -> Iterator[tuple[KalmanFilter, LikelihoodRatio]]:
        """Yield the filter and, while an encoder may return from a jump, the second filter."""
        yield self.kalman, self.evidence.ratio
        if (second := self.glitches.alternative) is not None:
            yield second.kalman, second.ratio

    def update(
        self, step: Step, inputs: InputHistory, t_s: float, *, is_judged: bool, watches_glitches: bool
    ) -> Iterator[TwinEvent]:
        """Update filters and evidence at the end of a block, with the measurement of the `step` that begins
        there; yield an event if an encoder has returned from a jump.
        """
        self.block += 1
        watches = watches_glitches and step.measured_rad is not None
        before = self.glitches.copies(self.kalman, self.evidence.ratio) if watches else None
        innovation = self._update_filter(self.kalman, self.evidence.ratio, step, inputs, is_judged)
        if innovation is not None:
            if is_judged and FILTER_SETTLING_s < self.age_s <= CALIBRATION_s:
                self.model_check.add(innovation.value)
            nats = self.evidence.add(innovation, t_s)
            # The evidence stays unchanged while an encoder may still return from a jump.
            if self.glitches.alternative is None:
                self.evidence_nats = nats
        angles_rad = self.kalman.state[:3]
        self._angles.remember(self.block, angles_rad)
        if watches:
            self.glitches.begin_jump(self.kalman, before)
        second = self.glitches.alternative
        if second is None:
            return  # no encoder may return from a jump
        innovation = self._update_filter(second.kalman, second.ratio, step, inputs, is_judged)
        if innovation is None:
            return
        second.ratio.update_cut(innovation, CUT_OFF_STD)
        if self.glitches.decide_return():
            # The filter without the jump replaces the first one.
            second, text = self.glitches.end_jump(t_s, self._block_s)
            self.kalman, self.evidence = second.kalman, PersistentEvidence(second.ratio)
            yield TwinEvent("glitch", t_s, text)

    def begin_onset(self) -> None:
        """Add the end of the present block to the onsets."""
        # A sudden change raises the alarm before its true onset is in the window. Onsets are therefore added
        # for half a second after an alarm. Then the window stays fixed until the final ranking.
        adds_onsets = self.alarm is None or self.block - self.alarm.block < RECENT
        if adds_onsets and self.age_s >= FILTER_SETTLING_s:
            for filter_, ratio in self.filters():
                ratio.begin_onset(self.block, filter_.state_sensitivity)

    def _update_filter(
        self, kalman: KalmanFilter, ratio: LikelihoodRatio, step: Step, inputs: InputHistory, is_judged: bool
    ) -> Innovation | None:
        """Update a filter with a measurement; return its innovation, None without a measurement."""
        # The innovation and its sensitivity are zero after voltages that the nominal flights do not contain,
        # so that the evidence stays.
        ages_s = ratio.ages(self.block) * self._block_s
        kalman.propagate_sensitivity(ages_s, ratio.is_ramp)
        if step.measured_rad is None:
            return None
        innovation = kalman.update(
            inputs.motor_time_s,
            step.measured_rad,
            step.samples,
            inputs.acting_V,
            amount=np.where(ages_s > 0.0, 1.0, 0.0),
            onset_rad=self._angles.at_onsets(ratio),
        )
        if is_judged:
            return innovation
        return Innovation(np.zeros(3), np.zeros_like(innovation.sensitivity))


class _ModelCheck:
    """The innovations of each axis in `CALIBRATION_s`, and whether they agree with the model."""

    def __init__(self) -> None:
        self._innovations: list[Floats] = []

    def add(self, innovation: Floats) -> None:
        """Add an `innovation`, (3,), in standard deviations."""
        self._innovations.append(innovation)

    def compared_with(self, expected: PieceVariance) -> ModelFit:
        """Compare the sums of the innovations over 1 s with those for which the threshold was set."""
        return compare_with(expected, piece_variance(np.array(self._innovations).reshape(-1, 3)))

    def contradiction(self, model_fit: ModelFit) -> str:
        """Describe the axis whose innovations are too large; empty if none are, or none were added."""
        # `model_fit`: The result of `compared_with`.
        if not self._innovations:
            return ""
        mean_square = np.mean(np.square(self._innovations), axis=0)
        worst_axis = int(np.argmax(mean_square))
        if mean_square[worst_axis] > _MAX_MEAN_SQUARE:
            rms = mean_square[worst_axis] ** 0.5
            return f"{AXES[worst_axis]} differs from its predictions by {rms:.1f} times the stated deviation"
        if model_fit.fits:
            return ""
        return (
            f"the errors about {model_fit.axis} over 1 s are {model_fit.ratio:.1f} times as large as "
            f"expected (chance: up to {model_fit.chance_ratio:.1f}), so the accepted rate of false alarms "
            "does not hold"
        )


class _AngleHistory:
    """Angles at the ends of the latest blocks. Since an onset, the error of a wrong encoder scale grows in
    proportion to the angle. Block k is in row k modulo the number of rows.
    """

    def __init__(self, scales: Sequence[tuple[int, int]]) -> None:
        self._angles_rad: Floats = np.zeros((_HISTORY_BLOCKS, 3))
        self._scales = scales

    def remember(self, block: int, angles_rad: Floats) -> None:
        """Keep the angles `angles_rad` [rad], (3,), at the end of a `block`."""
        self._angles_rad[block % len(self._angles_rad)] = angles_rad

    def at_onsets(self, ratio: LikelihoodRatio) -> Floats:
        """Return for each encoder scale the angle of its axis [rad] at each onset, (scales, onsets)."""
        rows = len(self._angles_rad)
        onset_rows = ((ratio.onset_blocks(column) % rows, axis) for column, axis in self._scales)
        return np.array([self._angles_rad[place] for place in onset_rows])


class _Ghost:
    """Overlapping open-loop simulations, called runs."""

    # A run starts from the filter's state every 0.2 s. The oldest run, of `_FREE_RUN_s`, is shown.

    def __init__(self, twin: TwinModel, step_s: float) -> None:
        self._twin, self._step_s = twin, step_s
        self._steps_between_runs = max(1, round(_FREE_RUN_s / _RUNS / step_s))
        # State of each run, oldest first, with the torques and zeros that the filter had at its start.
        self._runs: Floats = np.empty((0, twin.states))
        self._torque_Nm: Floats = np.empty((0, 3))
        self._zero_rad: Floats = np.empty((0, len(ZEROS)))
        self._steps = 0

    def begin(self) -> None:
        """Discard all runs, because the flight was interrupted."""
        self._runs, self._steps = self._runs[:0], 0
        self._torque_Nm, self._zero_rad = self._torque_Nm[:0], self._zero_rad[:0]

    def step(self, t_s: float, volts_V: Floats, state: Floats, torque_Nm: Floats, zero_rad: Floats) -> None:
        """Start a run if one is due, and advance all runs by a step. Shapes: `volts_V` (2,), `state`
        (states,), `torque_Nm, zero_rad` (3,).
        """
        if self._steps % self._steps_between_runs == 0:
            newest = slice(max(0, len(self._runs) + 1 - _RUNS), None)
            self._runs = np.vstack((self._runs[newest], state))
            self._torque_Nm = np.vstack((self._torque_Nm[newest], torque_Nm))
            self._zero_rad = np.vstack((self._zero_rad[newest], zero_rad))
        self._steps += 1
        twin, h = self._twin, self._step_s
        middle = twin.functions_without_derivatives.along(twin.at(t_s + 0.5 * h, self._runs, volts_V, h))
        _, gamma = _kalman.midpoint(middle.by_state, h)
        # k numbers the runs, i and j the rows and columns of their matrices.
        torque_rates = np.einsum("kij,kj->ki", middle.by_disturbance, self._torque_Nm)
        rates_with_torque = middle.rates[:, :, 0] + torque_rates
        self._runs = self._runs + np.einsum("kij,kj->ki", gamma, rates_with_torque)

    @property
    def angles_rad(self) -> Floats | None:
        """Angles that the encoders would show for the oldest run [rad], (3,); None before `_FREE_RUN_s`."""
        if len(self._runs) < _RUNS:
            return None
        angles_rad = self._runs[0, :3].copy()
        angles_rad[: len(ZEROS)] += self._zero_rad[0]
        return np.asarray(angles_rad + np.deg2rad([*(self._twin.rig[name].value for name in ZEROS), 0.0]))
