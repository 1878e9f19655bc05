"""Wrong signs and zeros of flights that are to be fitted, each by its name and with its remedy."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from heli_host.flight import Flight
from heli_host.tables import Column, Table
from heli_sim.rig import Rig

from heli_lab.errors import IdentifyError
from heli_lab.guess import thresholds
from heli_lab.guess.flown import fly_choices
from heli_lab.guess.motion import answers, rest_of
from heli_lab.guess.reference import Reference, reference_of
from heli_lab.guess.roles import ColumnAssignment, RegressionFit
from heli_lab.guess.scales import AXES
from heli_lab.guess.signals import signals_of

LEAST_S: Final = 5.0
"""Shorter flights are not looked at, s: less than five independent moments say nothing of a sign."""
_COLUMNS: Final = ("elevation_rad", "pitch_rad", "travel_rad", "front_V", "back_V")
_DEGREES: Final = (0.4 * 180.0 / math.pi, 2.5 * 180.0 / math.pi)
"""Accelerations that are this many times those of the rig file, on elevation and pitch alike, are of
degrees."""


@dataclass(frozen=True)
class WrongSign:
    """What is wrong with a flight.

    Parameters
    ----------
    what : str
        What it is, in a few words.
    remedy : str
        What to do about it.
    turned : tuple of str
        Axes that would have to count the other way; none where it is no sign.
    """

    what: str
    remedy: str
    turned: tuple[str, ...] = ()


def wrong_signs(flight: Flight, rig: Rig) -> tuple[WrongSign, ...]:
    """Find wrong signs and zeros of a flight.

    A sign is wrong where an axis goes against its cause beyond doubt, and the baseline model of the rig flies
    it clearly better the other way. An unusual rig is none of both.

    Parameters
    ----------
    flight : Flight
        The flight, in radians and volts.
    rig : Rig
        What is known of the rig.

    Returns
    -------
    tuple of WrongSign
        None where nothing is wrong, or nothing can be said.
    """
    if flight.duration_s < LEAST_S:
        return ()
    try:
        reference = reference_of(rig)
    except IdentifyError:
        return ()
    table = Table("flight", {name: Column(getattr(flight, name)) for name in _COLUMNS})
    signals = signals_of(table, flight.t_s, list(_COLUMNS))
    if any(np.ptp(signals.raw[name]) == 0.0 for name in _COLUMNS):
        return ()
    roles = ColumnAssignment(
        "elevation_rad", "pitch_rad", "travel_rad", ("front_V", "back_V"), False, (1.0, 1.0), 0.0, 0.0
    )
    # Sines of an angle in degrees would say nothing.
    degrees = _in_degrees(answers(signals, roles, reference), reference)
    if degrees is not None:
        return (degrees,)
    explained = answers(signals, roles, reference, dict.fromkeys(AXES, 1.0))
    suspects = _suspects(explained)
    if suspects:
        flown = {choice.name: choice.ratio for choice in fly_choices(flight, rig)}
        suspects = [
            sign
            for sign in suspects
            if not flown or flown[" and ".join(sign.turned)] < thresholds.CLEARLY_WORSE
        ]
    up = 1.0 if explained["elevation"].gain >= 0.0 else -1.0
    rest = rest_of(signals, "elevation_rad", math.degrees(up))
    far = thresholds.REST_DEG + reference.rest_tolerance_deg
    if rest.deg is not None and rest.lowest and abs(rest.deg) < far < abs(reference.rest_deg) - far:
        suspects.append(
            WrongSign(
                f"elevation is {rest.deg:.1f} deg where the flight rests: it was zeroed there, not at level",
                f"add {reference.rest_deg:g} deg to it, the rig file's table: offset_deg in a profile of "
                "heli-host import",
            )
        )
    return tuple(suspects)


def _in_degrees(explained: dict[str, RegressionFit], reference: Reference) -> WrongSign | None:
    times = [abs(explained[axis].gain / reference.gain[axis]) for axis in ("elevation", "pitch")]
    sure = all(explained[axis].nats > thresholds.SURE_NATS for axis in ("elevation", "pitch"))
    if not sure or not all(_DEGREES[0] < ratio < _DEGREES[1] for ratio in times):
        return None
    return WrongSign(
        f"elevation and pitch accelerate {times[0]:.0f} and {times[1]:.0f} times as fast as the rig can: "
        "they are in degrees",
        "multiply the angles by pi/180",
    )


def _suspects(explained: dict[str, RegressionFit]) -> list[WrongSign]:
    """What the fewest changes would make agree."""
    against = {
        axis: explained[axis].gain < 0.0 and explained[axis].nats > thresholds.SURE_NATS for axis in AXES
    }
    suspects = []
    if against["elevation"]:
        suspects.append(
            WrongSign(
                "elevation falls where the voltages rise: it counts the other way",
                "turn its sign; it is positive upwards",
                ("elevation",),
            )
        )
    if against["pitch"] and against["travel"]:
        suspects.append(
            WrongSign(
                "pitch falls where the front voltage rises, and travel goes against pitch: pitch counts the "
                "other way",
                "turn pitch's sign; it is positive when the front rotor is up",
                ("pitch",),
            )
        )
    elif against["pitch"]:
        suspects.append(
            WrongSign(
                "pitch falls where the front voltage rises: the motors are exchanged",
                "exchange front_V and back_V; or, if they are right, turn pitch's and travel's signs",
                ("pitch", "travel"),
            )
        )
    elif against["travel"]:
        suspects.append(
            WrongSign(
                "travel goes against pitch: it counts the other way",
                "turn its sign; it accelerates positive at positive pitch",
                ("travel",),
            )
        )
    return suspects
