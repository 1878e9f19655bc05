"""Routes: the setpoints of a plan as functions of time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from heli_host.arrays import Floats

Shape = Callable[[Floats], Floats]
"""From times within a piece, seconds (n,), to elevation, pitch and travel in degrees (n, axes)."""


@dataclass(frozen=True)
class PlannedExcitation:
    """An excitation that the board adds to the motor voltages during a piece."""

    signal: str  # Kind of excitation: name of a member of `heli_host.declaration.Excitation` in lower case
    front_V: float  # front_V, back_V: Amplitude on each motor
    back_V: float
    start_Hz: float  # start_Hz, stop_Hz: Frequencies
    stop_Hz: float
    duration_s: float  # Length
    seed: int  # Seed of prbs


@dataclass(frozen=True)
class Piece:
    """A stretch of a route."""

    phase: str  # Part of the flight: ``take-off`` or a plan's name
    name: str  # Kind of the piece, for messages: ``sine``, ``step`` ..
    start_s: float  # start_s, duration_s: Start on the route's time axis, and length [s]
    duration_s: float
    shape: Shape  # Function that returns the setpoints within the piece
    excitation: PlannedExcitation | None = None

    @property
    def end_deg(self) -> Floats:
        """Setpoints at its end, degrees (axes,)."""
        end_deg: Floats = self.shape(np.array([self.duration_s]))[0]
        return end_deg


@dataclass(frozen=True)
class Route:
    """Pieces that follow each other."""

    start_deg: Floats  # (axes,): Elevation, pitch and travel before the first piece
    pieces: tuple[Piece, ...] = ()  # In order of time, without gaps

    @property
    def duration_s(self) -> float:
        """Time from its start to its end, in seconds."""
        return self.pieces[-1].start_s + self.pieces[-1].duration_s if self.pieces else 0.0

    @property
    def end_deg(self) -> Floats:
        """Setpoints at its end, degrees (axes,)."""
        return self.pieces[-1].end_deg if self.pieces else self.start_deg

    @cached_property
    def _starts_s(self) -> Floats:
        return np.array([piece.start_s for piece in self.pieces])

    def then(
        self,
        phase: str,
        name: str,
        duration_s: float,
        shape: Shape,
        excitation: PlannedExcitation | None = None,
    ) -> Route:
        """Return the route with one more piece."""
        piece = Piece(phase, name, self.duration_s, duration_s, shape, excitation)
        return Route(self.start_deg, (*self.pieces, piece))

    def piece_at(self, t_s: float) -> Piece | None:
        """Return the piece at a time."""
        if not self.pieces or t_s < 0.0 or t_s >= self.duration_s:
            return None
        return self.pieces[max(0, int(np.searchsorted(self._starts_s, t_s, side="right")) - 1)]

    def evaluate(self, t_s: Floats) -> Floats:
        """Return the setpoints. Shapes: `t_s` (n,); returns (n, axes)."""
        setpoints_deg = np.empty((t_s.size, self.start_deg.size))
        setpoints_deg[:] = self.start_deg
        if not self.pieces:
            return setpoints_deg
        index = np.searchsorted(self._starts_s, t_s, side="right") - 1
        for number in set(index.tolist()) - {-1}:
            piece = self.pieces[number]
            is_in_piece = index == number
            setpoints_deg[is_in_piece] = piece.shape(
                np.minimum(t_s[is_in_piece] - piece.start_s, piece.duration_s)
            )
        return setpoints_deg


def hold(at_deg: Floats) -> Shape:
    """Return a shape that stays. Shapes: `at_deg` (axes,)."""
    return lambda t_s: np.tile(at_deg, (t_s.size, 1))


def ramp(from_deg: Floats, to_deg: Floats, duration_s: float) -> Shape:
    """Return a shape that goes straight from one point to another. Shapes: `from_deg, to_deg` (axes,)."""
    return lambda t_s: from_deg + np.outer(np.clip(t_s / duration_s, 0.0, 1.0), to_deg - from_deg)


def sine(from_deg: Floats, amplitude_deg: Floats, period_s: Floats, duration_s: float) -> Shape:
    """Return sines about the present point, faded in and out so that neither setpoint nor its rate jumps.
    Shapes: `from_deg` (axes,), `amplitude_deg` (axes,), `period_s` (axes,).
    """
    fades_s = fade_s(period_s, duration_s)

    def shape(t_s: Floats) -> Floats:
        column = t_s[:, None]
        envelope = _smooth_from_0_to_1(np.clip(np.minimum(column, duration_s - column) / fades_s, 0.0, 1.0))
        return from_deg + amplitude_deg * envelope * np.sin(2.0 * np.pi * column / period_s)

    return shape


def fade_s(period_s: Floats, duration_s: float) -> Floats:
    """Return how long a sine takes to reach its amplitude. Shapes: `period_s` (axes,).

    Over half a period the rate never exceeds that of the full sine, and its acceleration by a third at most.
    """
    return np.minimum(0.5 * period_s, 0.5 * duration_s)


def waypoints(at_s: Sequence[Floats], points_deg: Sequence[Floats], smooth: bool) -> Shape:
    """Return a path through points. Shapes: `at_s` (m,), `points_deg` (m,)."""

    def shape(t_s: Floats) -> Floats:
        columns = []
        for times, values in zip(at_s, points_deg, strict=True):
            if not smooth or times.size < 2:
                columns.append(np.interp(t_s, times, values))
                continue
            segment = np.clip(np.searchsorted(times, t_s, side="right") - 1, 0, times.size - 2)
            elapsed_share = np.clip((t_s - times[segment]) / (times[segment + 1] - times[segment]), 0.0, 1.0)
            columns.append(
                values[segment] + _smooth_from_0_to_1(elapsed_share) * (values[segment + 1] - values[segment])
            )
        return np.column_stack(columns)

    return shape


def _smooth_from_0_to_1(share: Floats) -> Floats:
    """Go from 0 to 1 with level ends."""
    return share * share * (3.0 - 2.0 * share)
