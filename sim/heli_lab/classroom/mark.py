"""The mark of a submission: its flights compared with those of the board's own control law."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Final

from heli_lab.classroom.grade import FlightScore

FULL: Final = 10.0
WEIGHTS: Final = {"rms_deg": 4.0, "settling_s": 2.0, "overshoot_percent": 2.0, "effort_V": 2.0}
"""Points of each number; they add up to `FULL`."""
FLOORS: Final = {"rms_deg": 0.2, "settling_s": 1.0, "overshoot_percent": 5.0, "effort_V": 0.02}
"""Smaller values earn no more points: two steps of the encoder, and what a flight with another seed changes.
With less, noise decides the mark; with more, a better law gets no better mark."""
_GOOD_WITHOUT_MOTION: Final = ("overshoot_percent", "effort_V")
NO_POINTS: Final = 10.0
"""Multiple of the reference without points; in between, points fall with the logarithm. An LQR without
integrals has 3 times the RMS error of the board's own law, and a slow PD law 7 times. With less, both get
nothing; with more, they get nearly the same."""


@dataclass(frozen=True)
class Mark:
    """Mark of one submission.

    Parameters
    ----------
    name : str
        Name of the submission.
    points : float
        From 0 to `FULL`.
    reason : str
        Why it was refused or did not fly to its end; empty if it did.
    scores : tuple of FlightScore
        One per flight; empty if it was refused.
    rig : str
        Outcome of the flight on the rig; empty without one.
    """

    name: str
    points: float = 0.0
    reason: str = ""
    scores: tuple[FlightScore, ...] = field(default_factory=tuple)
    rig: str = ""

    @property
    def refused(self) -> bool:
        """Whether it never flew."""
        return not self.scores

    def as_dict(self) -> dict[str, Any]:
        """Return the mark for JSON."""
        return {
            "submission": self.name,
            "points": self.points,
            "of": FULL,
            "reason": self.reason,
            "flights": [score.as_dict() for score in self.scores],
            "rig": self.rig,
        }

    def __str__(self) -> str:
        reason = f"; {self.reason}" if self.reason else ""
        return f"{self.name}: {self.points:.1f} of {FULL:.0f} points{reason}"


def points_of(score: FlightScore, reference: FlightScore) -> float:
    """Return the points of a flight: full points for each number that is as good as the reference.

    Numbers that the reference lacks do not count, and the others count for more. Little effort and little
    overshoot only count as far as the law follows its setpoints: motors that do nothing have both.

    Parameters
    ----------
    score : FlightScore
        Flight of the submission.
    reference : FlightScore
        The board's own law along the same plan.
    """
    if score.ended:
        return 0.0
    points_share = {name: _points_share(name, score, reference) for name in WEIGHTS}
    tracking_share = 1.0 if math.isnan(points_share["rms_deg"]) else points_share["rms_deg"]
    earned = possible = 0.0
    for name, share in points_share.items():
        if not math.isnan(share):
            possible += WEIGHTS[name]
            earned += WEIGHTS[name] * (min(share, tracking_share) if name in _GOOD_WITHOUT_MOTION else share)
    return FULL * earned / possible if possible else FULL


def _points_share(name: str, score: FlightScore, reference: FlightScore) -> float:
    """Share of the points for a number, 0 to 1; nan if the reference lacks it."""
    value, reference_value = getattr(score, name), getattr(reference, name)
    if math.isnan(reference_value):
        return math.nan
    if math.isnan(value):
        return 0.0
    if math.isinf(value) and not math.isinf(reference_value):
        return 0.0
    ratio = 1.0 if value <= reference_value else max(1.0, value / max(reference_value, FLOORS[name]))
    return max(0.0, 1.0 - math.log(ratio) / math.log(NO_POINTS))


def mark_of(name: str, scores: Sequence[FlightScore], references: Sequence[FlightScore]) -> Mark:
    """Return the mark of a submission: the mean over its flights.

    Parameters
    ----------
    name : str
        Name of the submission.
    scores, references : sequence of FlightScore
        Its flights, and those of the board's own law, in the same order.
    """
    points = [points_of(score, reference) for score, reference in zip(scores, references, strict=True)]
    reason = ", ".join(sorted({score.ended for score in scores if score.ended}))
    return Mark(name, round(sum(points) / len(points), 1), reason, tuple(scores))
