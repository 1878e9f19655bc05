"""Find the zero of the elevation from the arm's rest on the table at the beginning of a flight."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from heli_lab.setup.guess import thresholds
from heli_lab.setup.guess.regression.reference import Reference
from heli_lab.setup.guess.regression.signals import Signals
from heli_lab.setup.guess.result import Ambiguity

_STILL_deg: Final = 0.5
"""Largest range of the elevation at rest [deg]: five counts of an encoder with 4096 per turn."""
_MIN_RISE_deg: Final = 5.0
"""Smallest difference between the median of a flight and its beginning [deg] for the beginning to be a rest
on the table. Rest and level differ by some 25 deg, so values up to 20 distinguish a rest from a hover."""
_LOWEST_deg: Final = 3.0
"""Largest elevation above the lowest of a flight [deg] that still counts as the lowest. Flights are some
25 deg above their rest, so values up to 20 distinguish them."""


@dataclass(frozen=True)
class RestElevation:
    """Elevation at the beginning of a flight, where the arm may rest on its table."""

    deg: float | None  # Elevation at rest [deg], with its sign; None if the flight does not begin at rest
    median_deg: float  # Median of the elevation in the flight [deg]
    begins_lowest: bool  # Whether the flight begins at its lowest elevation


def rest_elevation(signals: Signals, column: str, deg_per_unit: float) -> RestElevation:
    """Find the elevation at which the arm rests at the beginning of a flight."""
    elevation_deg = deg_per_unit * signals.raw[column]
    # An unsigned counter that starts below 0 has an offset of one turn.
    elevation_deg = elevation_deg - 360.0 * np.round(np.median(elevation_deg) / 360.0)
    rest_rows = round(thresholds.REST_DURATION_S / thresholds.SAMPLE_STEP_s)
    beginning_deg = elevation_deg[:rest_rows]
    median_deg = float(np.median(elevation_deg))
    start_deg = float(np.median(beginning_deg))
    is_at_rest = float(np.ptp(beginning_deg)) < _STILL_deg and abs(median_deg - start_deg) > _MIN_RISE_deg
    return RestElevation(
        deg=start_deg if is_at_rest else None,
        median_deg=median_deg,
        begins_lowest=start_deg < float(elevation_deg.min()) + _LOWEST_deg,
    )


def elevation_zero(rest: RestElevation, reference: Reference) -> tuple[float, list[Ambiguity]]:
    """Decide which angle to add to the elevation so that it is 0 at level. Returns `offset_deg`,
    `ambiguities`.

    Programs zero the elevation either at level or at rest on the table. The rest at the beginning of the
    flight shows which, because the rig file states the angle of the arm on its table.
    """
    table_deg = reference.rest_deg
    tolerance_deg = thresholds.REST_TOLERANCE_DEG + reference.rest_tolerance_deg
    if rest.deg is None:
        if abs(rest.median_deg) < 0.5 * abs(table_deg):
            return 0.0, []
        return 0.0, [
            Ambiguity(
                "the elevation's zero",
                f"0 as it is, with {rest.median_deg:.0f} deg in flight",
                f"0 at rest, so {table_deg:g} deg to add",
                "the flight does not begin at rest; start logging while the arm is on the table",
            )
        ]
    zero_at_level = abs(rest.deg - table_deg) < tolerance_deg
    zero_at_rest = abs(rest.deg) < tolerance_deg
    if zero_at_level and rest.begins_lowest and not zero_at_rest:
        return 0.0, []
    if zero_at_rest and rest.begins_lowest and not zero_at_level:
        return table_deg - rest.deg, []
    at_rest = f"{table_deg - rest.deg:.1f} deg to add, so that it rests at {table_deg:g} deg"
    # A log that begins in flight may be zeroed there, and most pilots fly near level.
    in_flight = (
        "" if rest.begins_lowest else f", or {-rest.median_deg:.1f} deg to add, so that it flies at 0 deg"
    )
    return 0.0, [
        Ambiguity(
            "the elevation's zero",
            f"as it is, at rest {rest.deg:.1f} deg",
            f"{at_rest}{in_flight}",
            "with the rig file's table angle, neither level nor rest would be 0; measure the angle at rest",
        )
    ]
