"""Find wrong signs, zeros and units of a flight before it is fitted, each with a fix."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from heli_host.data.flight import Flight
from heli_host.data.tables import Column, Table
from heli_sim.rig import Rig

from heli_lab.errors import IdentifyError
from heli_lab.setup.guess import thresholds
from heli_lab.setup.guess.elevation_zero import RestElevation, rest_elevation
from heli_lab.setup.guess.regression.acceleration_fit import RegressionFit
from heli_lab.setup.guess.regression.assignment import ColumnAssignment
from heli_lab.setup.guess.regression.axis_regression import axis_regressions
from heli_lab.setup.guess.regression.reference import Reference, reference_of
from heli_lab.setup.guess.regression.scales import AXES
from heli_lab.setup.guess.regression.signals import column_signals
from heli_lab.setup.guess.sign_trials import try_sign_choices

MIN_DURATION_S: Final = 5.0
"""Shorter flights are not checked [s]: fewer than five independent samples do not decide a sign."""
_COLUMNS: Final = ("elevation_rad", "pitch_rad", "travel_rad", "front_V", "back_V")
_DEGREES_RATIO: Final = (0.4 * 180.0 / math.pi, 2.5 * 180.0 / math.pi)
"""Range of the ratio of measured to modelled acceleration, on elevation and pitch, for angles in degrees."""


@dataclass(frozen=True)
class WrongSign:
    """One wrong sign, zero or unit of a flight."""

    description: str  # The evidence and its cause, in a few words
    remedy: str  # How to correct the flight
    inverted_axes: tuple[str, ...] = ()  # Axes whose sign has to change; empty for a wrong zero or unit


def wrong_signs(flight: Flight, rig: Rig) -> tuple[WrongSign, ...]:
    """Find wrong signs and zeros of a flight.

    A sign is wrong if an axis clearly accelerates against its cause, and the baseline model of the rig fits
    clearly better with the opposite sign. An unusual rig fulfils neither condition.
    """
    if flight.duration_s < MIN_DURATION_S:
        return ()
    try:
        reference = reference_of(rig)
    except IdentifyError:
        return ()
    table = Table("flight", {name: Column(getattr(flight, name)) for name in _COLUMNS})
    signals = column_signals(table, flight.t_s, list(_COLUMNS))
    if any(np.ptp(signals.raw[name]) == 0.0 for name in _COLUMNS):
        return ()
    assignment = ColumnAssignment(
        "elevation_rad", "pitch_rad", "travel_rad", ("front_V", "back_V"), False, (1.0, 1.0), 0.0, 0.0
    )
    # The sine of an angle in degrees would be meaningless, so the unit is checked first.
    degrees = _angles_in_degrees(axis_regressions(signals, assignment, reference), reference)
    if degrees is not None:
        return (degrees,)
    regressions = axis_regressions(signals, assignment, reference, dict.fromkeys(AXES, 1.0))
    suspects = _sign_suspects(regressions)
    if suspects:
        suspects = _confirmed_by_simulation(suspects, flight, rig)
    elevation_sign = 1.0 if regressions["elevation"].gain >= 0.0 else -1.0
    wrong_zero = _zeroed_at_rest(
        rest_elevation(signals, "elevation_rad", math.degrees(elevation_sign)), reference
    )
    return (*suspects, wrong_zero) if wrong_zero is not None else tuple(suspects)


def _confirmed_by_simulation(suspects: list[WrongSign], flight: Flight, rig: Rig) -> list[WrongSign]:
    """Keep the suspects whose inverted signs let the baseline model fit clearly better.

    If the flight is too short to simulate, all suspects stay.
    """
    error_ratios = {choice.name: choice.error_ratio for choice in try_sign_choices(flight, rig)}
    if not error_ratios:
        return suspects
    return [
        sign
        for sign in suspects
        if error_ratios[" and ".join(sign.inverted_axes)] < thresholds.WRONG_SIGN_ERROR_RATIO
    ]


def _zeroed_at_rest(rest: RestElevation, reference: Reference) -> WrongSign | None:
    """Report an elevation that was zeroed at rest on the table instead of at level."""
    if rest.deg is None or not rest.begins_lowest:
        return None
    tolerance_deg = thresholds.REST_TOLERANCE_DEG + reference.rest_tolerance_deg
    is_zero = abs(rest.deg) < tolerance_deg
    # If the table is near level, a rest at 0 is right: the tolerances about both angles must not overlap.
    is_distinct = abs(reference.rest_deg) - tolerance_deg > tolerance_deg
    if not is_zero or not is_distinct:
        return None
    return WrongSign(
        f"elevation is {rest.deg:.1f} deg while the flight rests: it was zeroed there, not at level",
        f"add the rig file's table angle, {reference.rest_deg:g} deg, as offset_deg in a profile for "
        "heli-host import",
    )


def _angles_in_degrees(regressions: dict[str, RegressionFit], reference: Reference) -> WrongSign | None:
    """Report that elevation and pitch are in degrees, if their gains are about 57 times those of the rig."""
    gain_ratios = [abs(regressions[axis].gain / reference.gain[axis]) for axis in ("elevation", "pitch")]
    is_decisive = all(
        regressions[axis].log_likelihood_ratio > thresholds.DECISIVE_NATS for axis in ("elevation", "pitch")
    )
    if not is_decisive or not all(_DEGREES_RATIO[0] < ratio < _DEGREES_RATIO[1] for ratio in gain_ratios):
        return None
    return WrongSign(
        f"elevation and pitch accelerate {gain_ratios[0]:.0f} and {gain_ratios[1]:.0f} times as fast as the "
        "rig can: they are in degrees",
        "multiply the angles by pi/180",
    )


def _sign_suspects(regressions: dict[str, RegressionFit]) -> list[WrongSign]:
    """Name the fewest changes of sign after which all axes follow their causes."""
    contradicts_cause = {
        axis: regressions[axis].gain < 0.0
        and regressions[axis].log_likelihood_ratio > thresholds.DECISIVE_NATS
        for axis in AXES
    }
    suspects = []
    if contradicts_cause["elevation"]:
        suspects.append(
            WrongSign(
                "elevation falls when the voltages rise: it has the opposite sign",
                "invert elevation; it is positive upwards",
                ("elevation",),
            )
        )
    if contradicts_cause["pitch"] and contradicts_cause["travel"]:
        suspects.append(
            WrongSign(
                "pitch falls when the front voltage rises, and travel goes against pitch: pitch has the "
                "opposite sign",
                "invert pitch; it is positive when the front rotor is up",
                ("pitch",),
            )
        )
    elif contradicts_cause["pitch"]:
        suspects.append(
            WrongSign(
                "pitch falls when the front voltage rises: the motors are exchanged",
                "exchange front_V and back_V; if they are right, invert pitch and travel",
                ("pitch", "travel"),
            )
        )
    elif contradicts_cause["travel"]:
        suspects.append(
            WrongSign(
                "travel goes against pitch: travel has the opposite sign",
                "invert travel; positive pitch accelerates it in positive direction",
                ("travel",),
            )
        )
    return suspects
