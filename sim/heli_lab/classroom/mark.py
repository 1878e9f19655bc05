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
    parts : dict of str to float
        Points for each of `WEIGHTS` that the reference has, mean over the flights; they add up to `points`.
    references : tuple of FlightScore
        Flights of the board's own law with which `scores` were compared.
    rig : str
        Outcome of the flight on the rig; empty without one.
    """

    name: str
    points: float = 0.0
    reason: str = ""
    scores: tuple[FlightScore, ...] = ()
    parts: dict[str, float] = field(default_factory=dict)
    references: tuple[FlightScore, ...] = ()
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
            "parts": self.parts,
            "flights": [score.as_dict() for score in self.scores],
            "reference": [score.as_dict() for score in self.references],
            "rig": self.rig,
        }

    def __str__(self) -> str:
        reason = f"; {self.reason}" if self.reason else ""
        return f"{self.name}: {self.points:.1f} of {FULL:.0f} points{reason}"


def points_by_measure(score: FlightScore, reference: FlightScore) -> dict[str, float]:
    """Return the points for each number: full points if it is as good as the reference.

    Numbers that the reference lacks do not count, and the others count for more. Little effort and little
    overshoot only count as far as the law follows its setpoints: motors that do nothing have both.

    Parameters
    ----------
    score : FlightScore
        Flight of the submission.
    reference : FlightScore
        The board's own law along the same plan.
    """
    points_share = {name: _points_share(name, score, reference) for name in WEIGHTS}
    tracking_share = 1.0 if math.isnan(points_share["rms_deg"]) else points_share["rms_deg"]
    counted = {name: share for name, share in points_share.items() if not math.isnan(share)}
    if score.ended:
        return dict.fromkeys(counted, 0.0)
    possible = sum(WEIGHTS[name] for name in counted)
    points = {}
    for name, share in counted.items():
        earned_share = min(share, tracking_share) if name in _GOOD_WITHOUT_MOTION else share
        points[name] = FULL * WEIGHTS[name] / possible * earned_share
    return points


def points_of(score: FlightScore, reference: FlightScore) -> float:
    """Return the points of a flight: the sum of `points_by_measure`, and full points if no number counts."""
    points = points_by_measure(score, reference)
    if not points:
        return 0.0 if score.ended else FULL
    return sum(points.values())


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
    parts = [points_by_measure(score, reference) for score, reference in zip(scores, references, strict=True)]
    means = {
        measure: round(sum(of_flight.get(measure, 0.0) for of_flight in parts) / len(parts), 2)
        for measure in parts[0]
    }
    reason = ", ".join(sorted({score.ended for score in scores if score.ended}))
    points = list(map(points_of, scores, references))
    mean = round(sum(points) / len(points), 1)
    return Mark(name, mean, reason, tuple(scores), means, tuple(references))
