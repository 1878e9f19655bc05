"""Which encoder's scale a finished flight contradicts; the entry point ``heli_host.flight_checks``."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

from heli_host.flight import Flight
from heli_host.flight_checks import FlightFinding
from heli_sim.model.effects import effects_of
from heli_sim.model.named import model_named
from heli_sim.rig import load_rig

from heli_lab.encoder_scale.estimate import ScaleEstimate, scales_of

MAX_SIGMAS: Final = 3.0
"""Distance of a scale from 1, in standard errors, from which on it is a warning."""
MAX_NATS: Final = 0.5 * MAX_SIGMAS**2
"""The same as a log-likelihood ratio, so that a scale far from 1 whose standard error is small there counts
only if 1 fits worse."""


def wrong_scale(estimates: Sequence[ScaleEstimate]) -> ScaleEstimate | None:
    """The encoder whose scale explains a flight best, if it is significant; None if none is."""
    clear = [estimate for estimate in estimates if estimate.sigmas > MAX_SIGMAS and estimate.nats > MAX_NATS]
    return max(clear, key=lambda estimate: estimate.nats, default=None)


def warning_text(estimate: ScaleEstimate) -> str:
    """Return the warning as a text for readers."""
    digits = max(2, min(4, -math.floor(math.log10(estimate.standard_error))))
    return (
        f"{estimate.axis} encoder: it counts {estimate.scale:.{digits}f} ± "
        f"{estimate.standard_error:.{digits}f} (1 standard error) times what the rig's model predicts; "
        f"check {estimate.axis}_counts_per_rev and the rig's file"
    )


def check_flight(flight: Flight, rig: str) -> list[FlightFinding]:
    """Return a finding for the encoder whose scale a flight contradicts; none for a healthy flight.

    Parameters
    ----------
    flight : Flight
        A finished flight.
    rig : str
        Name of its rig, or path of the file.

    Raises
    ------
    SimError
        The rig cannot be read.
    """
    numbers = load_rig(rig)
    model = model_named(numbers.model or "multibody", effects_of(numbers))
    wrong = wrong_scale(scales_of(flight, numbers, model))
    if wrong is None:
        return []
    name = f"{wrong.axis}_encoder_scale"
    return [FlightFinding(name, wrong.scale, wrong.standard_error, warning_text(wrong))]
