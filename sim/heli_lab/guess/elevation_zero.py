"""Zero of the elevation, from the rest on the table at the beginning of a flight."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from heli_lab.guess import thresholds
from heli_lab.guess.regression.reference import Reference
from heli_lab.guess.regression.signals import Signals
from heli_lab.guess.result import Ambiguity


@dataclass(frozen=True)
class RestElevation:
    """Elevation at the beginning of a flight, where the arm may rest on its table.

    Parameters
    ----------
    deg : float or None
        Elevation at rest [deg], with its sign; None if the flight does not begin at rest.
    median_deg : float
        Median of the elevation in the flight [deg].
    lowest : bool
        Whether the flight begins at its lowest elevation.
    """

    deg: float | None
    median_deg: float
    lowest: bool


def rest_elevation(signals: Signals, column: str, deg: float) -> RestElevation:
    """Find the rest at the beginning of the elevation `column`; `deg` is its unit in degrees, with sign."""
    elevation = deg * signals.raw[column]
    # An unsigned counter that starts below 0 has an offset of one turn.
    elevation = elevation - 360.0 * np.round(np.median(elevation) / 360.0)
    rows = round(thresholds.REST_DURATION_S / thresholds.SAMPLE_STEP_s)
    begin = elevation[:rows]
    typical = float(np.median(elevation))
    start = float(np.median(begin))
    still = float(np.ptp(begin)) < 0.5 and abs(typical - start) > 5.0
    lowest = start < float(elevation.min()) + 3.0
    return RestElevation(start if still else None, typical, lowest)


def elevation_zero(rest: RestElevation, reference: Reference) -> tuple[float, list[Ambiguity]]:
    """Zero of the elevation, from its value at rest on the table.

    Parameters
    ----------
    rest : RestElevation
        Elevation at the beginning of the flight.
    reference : Reference
        Table angle of the rig file.

    Returns
    -------
    offset_deg : float
        Angle to add to the elevation [deg].
    ambiguities : list of Ambiguity
        One if the file does not decide the zero.
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
    if zero_at_level and rest.lowest and not zero_at_rest:
        return 0.0, []
    if zero_at_rest and rest.lowest and not zero_at_level:
        return table_deg - rest.deg, []
    at_rest = f"{table_deg - rest.deg:.1f} deg to add, so that it rests at {table_deg:g} deg"
    # A log that begins in flight may be zeroed there, and most pilots fly near level.
    in_flight = "" if rest.lowest else f", or {-rest.median_deg:.1f} deg to add, so that it flies at 0 deg"
    return 0.0, [
        Ambiguity(
            "the elevation's zero",
            f"as it is, at rest {rest.deg:.1f} deg",
            f"{at_rest}{in_flight}",
            "with the rig file's table angle, neither level nor rest would be 0; measure the angle at rest",
        )
    ]
