"""Compute the mark of a submission: compare its flights with those of the board's own control law."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Final

from heli_lab.apps.classroom.grade import FlightScore

FULL: Final = 10.0
"""Points of a submission that is as good as the board's own law."""
WEIGHTS: Final = {"rms_deg": 4.0, "settling_s": 2.0, "overshoot_percent": 2.0, "effort_V": 2.0}
"""Largest points of each measure of a `FlightScore`; they add up to `FULL`."""
FLOORS: Final = {"rms_deg": 0.2, "settling_s": 1.0, "overshoot_percent": 5.0, "effort_V": 0.02}
"""Values of the measures below which a better flight earns no more points: two encoder counts, or the
difference between flights with other seeds. With lower values, noise decides the mark; with higher ones,
a better law gets no better mark."""
POINTS: Final = {
    "rms_deg": "rms_points",
    "settling_s": "settling_points",
    "overshoot_percent": "overshoot_points",
    "effort_V": "effort_points",
}
"""Names of the points for each measure, in tables and in JSON."""
MIN_MOTION_deg: Final = 2.0
"""Smallest range of the setpoints of a submitted plan [deg].

The reference flies the same plan. A plan that only holds would therefore earn all points. Lower: such plans
pass. Higher: plans with small steps are refused."""
_GOOD_WITHOUT_MOTION: Final = ("overshoot_percent", "effort_V")
"""Measures that are best if the motors do nothing."""
NO_POINTS: Final = 10.0
"""Multiple of the reference's value that earns no points; in between, points fall with the logarithm. An LQR
without integrals has 3 times the RMS error of the board's own law, and a slow PD law 7 times. With a lower
multiple, both get nothing; with a higher one, they get nearly the same."""


@dataclass(frozen=True)
class Mark:
    """Mark of one submission."""

    name: str  # Name of the submission
    points: float = 0.0  # Points, from 0 to `FULL`
    reason: str = ""
    """Why the submission was refused, or did not complete its flights; empty if it completed them."""
    scores: tuple[FlightScore, ...] = ()  # One per flight; empty if the submission was refused
    parts: dict[str, float] = field(default_factory=dict)
    """Points for each measure that the reference has, by the names in `POINTS`, mean over the flights; they
    add up to `points`."""
    references: tuple[FlightScore, ...] = ()
    """Flights of the board's own law, with which `scores` are compared."""
    rig: str = ""  # Outcome of the flight on the rig; empty if there was no such flight

    @property
    def refused(self) -> bool:
        """Whether the submission did not fly at all."""
        return not self.scores

    def mean(self, measure: str) -> float:
        """Return the mean of a measure over the flights; nan if a flight lacks it."""
        values = [getattr(score, measure) for score in self.scores]
        return sum(values) / len(values) if values else math.nan

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
    """Compute the points for each measure: full points if it is as good as that of the reference.

    If the reference lacks a measure, such as the overshoot of a plan without a step, the other measures count
    more. Effort and overshoot earn at most the share of points that the RMS error earns, because motors that
    do nothing have little effort and no overshoot.
    """
    shares = {name: _points_share(name, score, reference) for name in WEIGHTS}
    tracking_share = 1.0 if math.isnan(shares["rms_deg"]) else shares["rms_deg"]
    counted_shares = {name: share for name, share in shares.items() if not math.isnan(share)}
    if score.ended:
        return dict.fromkeys(counted_shares, 0.0)
    total_weight = sum(WEIGHTS[name] for name in counted_shares)
    points = {}
    for name, share in counted_shares.items():
        earned_share = min(share, tracking_share) if name in _GOOD_WITHOUT_MOTION else share
        points[name] = FULL * WEIGHTS[name] / total_weight * earned_share
    return points


def points_of(score: FlightScore, reference: FlightScore) -> float:
    """Return the points of a flight: the sum of `points_by_measure`."""
    return sum(points_by_measure(score, reference).values())


def _points_share(name: str, score: FlightScore, reference: FlightScore) -> float:
    """Compute the share of the points for the measure `name`, 0 to 1; nan if the reference lacks the
    measure.
    """
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
    """Compute the mark of a submission: the mean of the points of its flights."""
    flights = list(zip(scores, references, strict=True))
    by_flight = [points_by_measure(score, reference) for score, reference in flights]
    mean_by_measure = {
        POINTS[measure]: round(sum(points.get(measure, 0.0) for points in by_flight) / len(by_flight), 2)
        for measure in by_flight[0]
    }
    flight_points = [points_of(score, reference) for score, reference in flights]
    return Mark(
        name=name,
        points=round(sum(flight_points) / len(flight_points), 1),
        reason=", ".join(sorted({score.ended for score in scores if score.ended})),
        scores=tuple(scores),
        parts=mean_by_measure,
        references=tuple(references),
    )
