"""Estimate the states of a flight at even times, about which models are then linearised.

Encoders are far finer than the motion, so that the trajectory hardly depends on the model. At first, each
position is filtered as if random accelerations drove it; later, by the model's equations. The states before
and after the measurement of each step are kept. Neither depends on later measurements. A smoothed trajectory
would contain the innovations that the model must explain, and a wrong scale of a sensor would then always be
significant.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np
from heli_host.data.arrays import Booleans, Floats, Integers

from heli_lab.fit import _kalman
from heli_lab.fit.grey_box import Recording, quantisation_std

STEP_s: Final = 0.01
"""Longest step of the trajectory. The midpoint rule has an error of (w h)^2 / 24 of an acceleration: 0.04
% if a position oscillates with 10 rad/s. Longer: inputs that change within a step are blurred. Shorter:
the estimation takes longer."""

REST_s: Final = 0.5
"""Time for which the count of an axis must stay the same for it to be at rest. Set with `REST_EDGE_s` on
thirteen simulated flights with dry friction in gusts (2026-11): all friction torques are estimated within 2.3
standard errors; with 0.3 s, three are not. Shorter: an axis that moves slowly counts as at rest. Much longer:
an axis that dry friction holds between two moves counts as moving."""
REST_EDGE_s: Final = 0.06
"""Time at the beginning and at the end of a constant count that does not count as rest [s]: an axis
starts and stops within a count. With a third of this time, friction is estimated up to 6 standard errors
too small."""

RETURN_s: Final = 0.2
"""Time for which the count of an axis must stay the same for the axis to have moved into its play and back.
Set on six simulated flights with plays of 0.5 to 3 degrees (2026-11). Longer, 0.3 s: the likelihoods of
plays of pitch lose 190 and 230 nats. Shorter, 0.15 s: the likelihoods gain up to 27 nats, but an axis that
moves slowly counts as within its play."""

_RETURN_SHARE: Final = 0.75
"""How far an axis moves back into its play, in halves of the play, before it continues in the old
direction: 0.4 to 0.8 in two simulated flights in gusts (2026-11). With 0, the error of the axis' position
is estimated as a disturbance without autocorrelation."""


@dataclass(frozen=True)
class KinematicModel:
    """Positions driven by random accelerations alone, for a first trajectory without a model.

    Parameters
    ----------
    acceleration_std : float
        Standard deviation of the accelerations, in the outputs' unit per s2: more than the machine reaches.
    correlation_time_s : float
        Correlation time of the accelerations.
    rate_std, position_std : float
        Standard deviations of the initial rates and positions, in the outputs' unit per s and in that unit.
    """

    acceleration_std: float
    correlation_time_s: float
    rate_std: float
    position_std: float


@dataclass(frozen=True)
class ReferenceTrajectory:
    """States of a flight at even times, as a filter estimates them: a model is linearised about them.

    Parameters
    ----------
    record : Recording
        The flight.
    every : int
        Rows of the flight per step.
    measured : ndarray (n, m)
        Outputs at the beginning of each step, mean of the samples within half a step.
    variance : ndarray (n, m)
        Variance of the quantisation errors of `measured`.
    predicted, filtered : ndarray (n, 2 m)
        Positions and rates at the beginning of each step, before and after its measurement.
    windows : tuple of slice
        Steps of each part to use.
    at_rest : ndarray (n, m)
        Whether each output is at rest. The rate is then set to 0: otherwise quantisation errors would decide
        in which direction dry friction acts.
    directions : ndarray (n, m)
        Direction in which each output moved last, -1 to 1, which is also its position in its play. Between
        two moves of opposite direction, it changes gradually from the one to the other.
    direction_variance : ndarray (n, m)
        Variance of the error of `directions`.
    pause_s : ndarray (n, m)
        Time for which the count of each output stays the same [s]. Errors of `directions` hardly change
        during it.
    """

    record: Recording
    every: int
    measured: Floats
    variance: Floats
    predicted: Floats
    filtered: Floats
    windows: tuple[slice, ...]
    at_rest: Booleans
    directions: Floats
    direction_variance: Floats
    pause_s: Floats

    @property
    def step_s(self) -> float:
        """Length of a step."""
        return self.record.step_s * self.every

    @property
    def rows(self) -> Integers:
        """Steps of all windows, one window after the other."""
        return np.concatenate([np.arange(window.start, window.stop) for window in self.windows]).astype(
            np.int64
        )

    def refiltered(self, predicted: Floats, filtered: Floats) -> ReferenceTrajectory:
        """Return the same flight with the states of a better filter.

        Parameters
        ----------
        predicted, filtered : ndarray (n, 2 m)
            Positions and rates before and after each measurement.
        """
        return replace(
            self,
            predicted=_with_zero_rates_at_rest(predicted, self.at_rest),
            filtered=_with_zero_rates_at_rest(filtered, self.at_rest),
        )


def kinematic_filter(record: Recording, kinematics: KinematicModel) -> ReferenceTrajectory:
    """Estimate a reference trajectory without a model of the machine, as if random accelerations drove it.

    Parameters
    ----------
    record : Recording
        The flight.
    kinematics : KinematicModel
        Size and correlation time of the accelerations.
    """
    # Rows per step; the small number corrects the rounding of a whole quotient.
    every = max(1, int(STEP_s / record.step_s + 1e-6))
    step_s = record.step_s * every
    # First row of each step.
    rows = np.arange(len(record.t_s) // every) * every
    measured, sample_count = _centred_means(record, rows, every // 2)
    variance = np.broadcast_to(quantisation_std(record) ** 2, measured.shape)
    # A first pass gives rough rates, and the rates the variance of the means for a second pass.
    _, rough = _filter_kinematics(measured, variance, step_s, kinematics)
    rough_rates = rough[:, measured.shape[1] :]
    # The errors of the averaged samples are independent if the count changes between them, and equal at rest.
    counts_per_step = np.abs(rough_rates) * record.step_s * every / record.resolution
    variance = variance / (1.0 + (sample_count - 1.0) * np.minimum(counts_per_step, 1.0))
    predicted, filtered = _filter_kinematics(measured, variance, step_s, kinematics)
    windows = []
    for first_row, stop_row in record.segments:
        first_step, stop_step = math.ceil(first_row / every), stop_row // every
        if stop_step - first_step > 1:  # A single step shows no motion
            windows.append(slice(first_step, stop_step))
    at_rest = _at_rest(record, rows)
    in_play = _positions_in_play(record, rows)
    return ReferenceTrajectory(
        record=record,
        every=every,
        measured=measured,
        variance=variance,
        predicted=_with_zero_rates_at_rest(predicted, at_rest),
        filtered=_with_zero_rates_at_rest(filtered, at_rest),
        windows=tuple(windows),
        at_rest=at_rest,
        directions=in_play.directions,
        direction_variance=in_play.variance,
        pause_s=in_play.pause_s,
    )


def _centred_means(record: Recording, rows: Integers, half: int) -> tuple[Floats, Floats]:
    """Average the outputs around each of some rows, over at most `half` rows on either side. Returns shape
    `mean` (n, m), `count` (n, 1).
    """
    sums = np.vstack((np.zeros(record.outputs.shape[1]), np.cumsum(record.outputs, axis=0)))
    low, high = np.maximum(rows - half, 0), np.minimum(rows + half + 1, len(record.t_s))
    half_width = np.minimum(rows - low, high - 1 - rows)
    low, high = rows - half_width, rows + half_width + 1
    count = (high - low)[:, None].astype(float)
    return (sums[high] - sums[low]) / count, count


def _count_changes(record: Recording) -> Booleans:
    """Find where the count of each output changes from a row to the next, shape (n - 1, m)."""
    return np.abs(np.diff(record.outputs, axis=0)) > 0.5 * record.resolution


class _PositionsInPlay(NamedTuple):
    """`directions`, `direction_variance` and `pause_s` of a ReferenceTrajectory, shape (n, m) each."""

    directions: Floats
    variance: Floats
    pause_s: Floats


def _positions_in_play(record: Recording, nodes: Integers) -> _PositionsInPlay:
    """Estimate the position of each output within its play, from the directions in which its count moved.
    Shapes: `nodes` (n,).
    """
    # The position is 1 or -1, the direction of the last move, while the count changes. If an axis reverses,
    # its position changes with the square of the time since the count stopped. If the count rests for long
    # and then continues in the same direction, the axis has moved into the play and back.
    # Within the play, the count does not depend on the position of the axis, so that the play is one wide
    # cell of a quantiser (Widrow and Kollar, Quantization Noise, 2008). The position has a beta distribution
    # between both sides, uniform if its mean is in the middle; its variance is (1 - mean^2) / 3.
    changed = _count_changes(record)
    directions = np.zeros((len(nodes), changed.shape[1]))
    pause_s = np.zeros_like(directions)
    for axis in range(changed.shape[1]):
        change_rows = np.flatnonzero(changed[:, axis])
        # Before the first move and after the last one, the axis is anywhere in its play: direction 0.
        moves = np.concatenate(([-1], change_rows, [len(changed)]))
        signs = np.concatenate(([0.0], np.sign(np.diff(record.outputs[:, axis])[change_rows]), [0.0]))
        # Indices in `moves` of the move after each node, and of the move before it. A move in row k is the
        # change from row k to the next, at k + 0.5.
        following = np.searchsorted(moves + 0.5, nodes)
        preceding = following - 1
        pause_rows = moves[following] - moves[preceding]
        # Share of the pause that has passed, 0 to 1.
        share = (nodes - moves[preceding] - 0.5) / pause_rows
        # Change of the direction from move to move; 0 if the axis goes on as before.
        reversal = signs[following] - signs[preceding]
        # The axis moves slowly into the play and fast back: s^2 (1 - s) is at most 1 / 6.75.
        excursion = _RETURN_SHARE * 6.75 * share**2 * (1.0 - share)
        has_returned = (reversal == 0.0) & (pause_rows * record.step_s >= RETURN_s)
        directions[:, axis] = (
            signs[preceding] + reversal * share**2 - np.where(has_returned, signs[preceding] * excursion, 0.0)
        )
        pause_s[:, axis] = pause_rows * record.step_s
    return _PositionsInPlay(directions, variance=(1.0 - directions**2) / 3.0, pause_s=pause_s)


def _at_rest(record: Recording, nodes: Integers) -> Booleans:
    """Find whether each output is at rest in the rows `nodes` of a flight, shape (n, m)."""
    changed = _count_changes(record)
    at_rest = np.zeros((len(nodes), changed.shape[1]), bool)
    for axis in range(changed.shape[1]):
        # Edges of the runs of rows with the same count.
        edges = np.concatenate(([0], np.flatnonzero(changed[:, axis]) + 1, [len(record.outputs)]))
        run = np.searchsorted(edges, nodes, side="right") - 1
        start, stop = edges[run], edges[run + 1]
        margin_rows = REST_EDGE_s / record.step_s
        is_long = (stop - start) * record.step_s >= REST_s
        at_rest[:, axis] = is_long & (nodes >= start + margin_rows) & (nodes < stop - margin_rows)
    return at_rest


def _with_zero_rates_at_rest(states: Floats, at_rest: Booleans) -> Floats:
    """Set the rate of each output at rest to 0 in `states`, positions and rates, shape (n, 2 m)."""
    outputs = at_rest.shape[1]
    rates: Floats = np.where(at_rest, 0.0, states[:, outputs:])
    return np.hstack((states[:, :outputs], rates))


def _filter_kinematics(
    measured: Floats, variance: Floats, step_s: float, kinematics: KinematicModel
) -> tuple[Floats, Floats]:
    """Estimate positions and rates by a Kalman filter, for positions that random accelerations drive.
    Shapes: `measured, variance` (n, m); returns `predicted, filtered` (n, 2 m).
    """
    step_count, output_count = measured.shape
    identity, zero = np.eye(output_count), np.zeros((output_count, output_count))
    # State: positions, then rates. Both integrate an acceleration that is constant within a step.
    transition = np.block([[identity, step_s * identity], [zero, identity]])
    acceleration_input = np.vstack((0.5 * step_s**2 * identity, step_s * identity))
    measurement = np.hstack((identity, zero))
    relative = measured - measured[0]  # The filter starts at 0
    no_drive = np.zeros((step_count, 2 * output_count, 1))
    before, after = _kalman.track(
        np.broadcast_to(transition, (step_count, *transition.shape)).copy(),
        np.broadcast_to(acceleration_input, (1, step_count, *acceleration_input.shape)).copy(),
        np.broadcast_to(measurement, (step_count, *measurement.shape)).copy(),
        np.ascontiguousarray(variance),
        np.full(output_count, np.exp(-step_s / kinematics.correlation_time_s)),
        np.full(output_count, kinematics.acceleration_std**2),
        np.repeat([kinematics.position_std**2, kinematics.rate_std**2], output_count),
        no_drive,
        relative[:, :, None].copy(),
    )
    start = np.hstack((measured[0], np.zeros(output_count)))
    # The columns after positions and rates are the accelerations.
    return before[:, : 2 * output_count] + start, after[:, : 2 * output_count] + start
