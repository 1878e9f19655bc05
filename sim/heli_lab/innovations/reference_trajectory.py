"""The course of a flight: states at even times as a filter follows them, about which models are linearised.

Encoders show the angles to a thousandth of a radian, so the course hardly depends on the model: at first each
axis is followed as if pushed by chance alone, then by the rig's own equations. A state before and one after a
step's measurement are kept. Neither looks ahead: what depends on a smoothed course knows the innovations that
it is to explain, and a scale of an encoder would always be found.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from heli_host.arrays import Flags, Floats, Integers

from heli_lab.identify import Record
from heli_lab.innovations import _kalman

STEP_s: Final = 0.01
"""Longest step of the course. By the midpoint rule it costs (w h)^2 / 24 of an acceleration: 0.04 % where an
axis swings with 10 rad/s. Longer: thrust that changes within a step is blurred. Shorter: time."""

REST_s: Final = 0.5
"""Time over which the count of an axis must stay the same for it to be at rest. Set with `REST_EDGE_s` on
thirteen simulated flights with dry friction in gusts (2026-11): all of its sizes come out within 2.3 standard
errors, with 0.3 s three of them do not. Shorter: an axis that moves slowly passes for held. Much longer: one
that dry friction holds between two moves passes for moving."""
REST_EDGE_s: Final = 0.06
"""Share of such a time at its beginning and at its end that is not rest: within a count an axis sets off and
slows down unseen. A third of it: friction comes out up to 6 standard errors too small."""

_BACK: Final = 0.75
"""How far an axis comes back in its play, in halves of the play, before it moves on as before: 0.4 to 0.8 on
two simulated flights in gusts (2026-11). Zero: what it is off then passes for gusts of no memory."""

# Each axis pushed by chance alone, for the first smoothing: far more than rigs of this kind accelerate.
_ACCELERATION_STD_rad_s2: Final = 5.0
_ACCELERATION_MEMORY_s: Final = 0.15
_RATE_STD_rad_s: Final = 1.0
_ANGLE_STD_rad: Final = 0.1


@dataclass(frozen=True)
class ReferenceTrajectory:
    """States of a flight at even times.

    Parameters
    ----------
    record : Record
        The flight.
    every : int
        Rows of the flight in a step.
    measured_rad : ndarray (n, 3)
        Angles at the beginning of each step, mean of the samples within half a step.
    variance_rad2 : ndarray (n, 3)
        Variance of their quantisation errors.
    predicted, filtered : ndarray (n, 6)
        Angles and rates at the beginning of each step, before and after its measurement.
    windows : tuple of slice
        Steps of each part in free flight.
    at_rest : ndarray (n, 3)
        Whether each axis is at rest. Its rates are zero there: by which side of zero the errors of an encoder
        at rest put them, dry friction would act now to one side and now to the other.
    directions : ndarray (n, 3)
        In which direction each axis has moved last, -1 to 1: where in a play it is. While its count stays the
        same between two moves of opposite direction it goes from one to the other.
    """

    record: Record
    every: int
    measured_rad: Floats
    variance_rad2: Floats
    predicted: Floats
    filtered: Floats
    windows: tuple[slice, ...]
    at_rest: Flags
    directions: Floats

    @property
    def step_s(self) -> float:
        """Length of a step."""
        return self.record.step_s * self.every

    @property
    def rows(self) -> Integers:
        """Steps in free flight, one window after the other."""
        return np.concatenate([np.arange(window.start, window.stop) for window in self.windows]).astype(
            np.int64
        )

    def refiltered(self, predicted: Floats, filtered: Floats) -> ReferenceTrajectory:
        """Keep everything but the states `predicted` and `filtered` by a better filter, shape (n, 6) each."""
        return replace(self, predicted=_held(predicted, self.at_rest), filtered=_held(filtered, self.at_rest))


def kinematic_filter(record: Record, step_s: float = STEP_s) -> ReferenceTrajectory:
    """Follow the angles of a flight without a model, in steps of `step_s` at most, or of the log's own."""
    every = max(1, int(step_s / record.step_s + 1e-6))
    count = len(record.t_s) // every
    half = every // 2
    sums = np.vstack((np.zeros(3), np.cumsum(record.angles_rad, axis=0)))
    nodes = np.arange(count) * every
    low, high = np.maximum(nodes - half, 0), np.minimum(nodes + half + 1, len(record.t_s))
    width = np.minimum(nodes - low, high - 1 - nodes)
    low, high = nodes - width, nodes + width + 1
    measured = (sums[high] - sums[low]) / (high - low)[:, None]
    variance = np.broadcast_to(record.sigma_rad**2, measured.shape)
    _, state = _kinematic(measured, variance, record.step_s * every)
    samples = (high - low)[:, None].astype(float)
    crossings = np.abs(state[:, 3:]) * record.step_s * every / record.count_rad
    # Samples of an angle that crosses a count in a step share it out; those of one at rest repeat it.
    variance = variance / (1.0 + (samples - 1.0) * np.minimum(crossings, 1.0))
    windows = tuple(
        slice(-(-start // every), stop // every)
        for start, stop in record.segments
        if stop // every - -(-start // every) > 1
    )
    before, after = _kinematic(measured, variance, record.step_s * every)
    at_rest = _at_rest(record, nodes)
    return ReferenceTrajectory(
        record,
        every,
        measured,
        variance,
        _held(before, at_rest),
        _held(after, at_rest),
        windows,
        at_rest,
        _directions(record, nodes),
    )


def _changed(record: Record) -> Flags:
    """Whether each axis' count, shape (n - 1, 3), changes from a row to the next."""
    changed: Flags = np.abs(np.diff(record.angles_rad, axis=0)) > 0.5 * record.count_rad
    return changed


def _directions(record: Record, nodes: Integers) -> Floats:
    """In which direction each axis has moved last, shape (n, 3), in these rows of a flight.

    An axis that turns round stands still when its count stops, and from there falls through a play ever
    faster: as the square of the time. One whose count rests long and that then moves on has been on its way
    through the play and back.
    """
    directions, changed = np.zeros((len(nodes), 3)), _changed(record)
    for axis in range(3):
        moves = np.flatnonzero(changed[:, axis])
        if not len(moves):
            continue
        signs = np.sign(np.diff(record.angles_rad[:, axis])[moves])
        after = np.searchsorted(moves + 0.5, nodes)
        last, following = np.clip(after - 1, 0, None), np.clip(after, None, len(moves) - 1)
        rows = np.maximum(moves[following] - moves[last], 1)
        share = np.clip((nodes - moves[last] - 0.5) / rows, 0.0, 1.0)
        turned = signs[following] - signs[last]
        # Slowly there, fast back: s^2 (1 - s) is at most 1 / 6.75.
        there_and_back = _BACK * 6.75 * share**2 * (1.0 - share)
        returned = (turned == 0.0) & (rows * record.step_s >= REST_s)
        directions[:, axis] = (
            signs[last] + turned * share**2 - np.where(returned, signs[last] * there_and_back, 0.0)
        )
    return directions


def _at_rest(record: Record, nodes: Integers) -> Flags:
    """Whether each axis, shape (n, 3), is at rest in these rows of a flight."""
    changed = _changed(record)
    at_rest = np.zeros((len(nodes), 3), bool)
    for axis in range(3):
        edges = np.concatenate(([0], np.flatnonzero(changed[:, axis]) + 1, [len(record.angles_rad)]))
        run = np.searchsorted(edges, nodes, side="right") - 1
        first, last = edges[run], edges[run + 1]
        margin = REST_EDGE_s / record.step_s
        long = (last - first) * record.step_s >= REST_s
        at_rest[:, axis] = long & (nodes >= first + margin) & (nodes < last - margin)
    return at_rest


def _held(states: Floats, at_rest: Flags) -> Floats:
    rates: Floats = np.where(at_rest, 0.0, states[:, 3:])
    return np.hstack((states[:, :3], rates))


def _kinematic(measured_rad: Floats, variance_rad2: Floats, step_s: float) -> tuple[Floats, Floats]:
    count = len(measured_rad)
    transition = np.eye(6)
    transition[:3, 3:] = step_s * np.eye(3)
    push = np.vstack((0.5 * step_s**2 * np.eye(3), step_s * np.eye(3)))
    measurement = np.hstack((np.eye(3), np.zeros((3, 3))))
    relative = measured_rad - measured_rad[0]
    before, after = _kalman.track(
        np.broadcast_to(transition, (count, 6, 6)).copy(),
        np.broadcast_to(push, (1, count, 6, 3)).copy(),
        np.broadcast_to(measurement, (count, 3, 6)).copy(),
        np.ascontiguousarray(variance_rad2),
        np.full(3, np.exp(-step_s / _ACCELERATION_MEMORY_s)),
        np.full(3, _ACCELERATION_STD_rad_s2**2),
        np.array([_ANGLE_STD_rad**2] * 3 + [_RATE_STD_rad_s**2] * 3),
        np.zeros((count, 6, 1)),
        relative[:, :, None].copy(),
    )
    start = np.hstack((measured_rad[0], np.zeros(3)))
    return before[:, :6] + start, after[:, :6] + start
