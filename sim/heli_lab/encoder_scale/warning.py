"""Warn after a flight if an encoder seems to have wrong counts per turn.

`check_flight` is an entry point ``heli_host.flight_checks``.
"""

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
"""Distance of a scale from 1, in standard errors, above which there is a warning."""
MAX_NATS: Final = 0.5 * MAX_SIGMAS**2
"""The same threshold as a log-likelihood ratio. Both must be exceeded: far from 1, a standard error may
be small although a scale of 1 fits as well."""


def wrong_scale(estimates: Sequence[ScaleEstimate]) -> ScaleEstimate | None:
    """Return the encoder scale that differs from 1 most clearly; None if no difference is significant."""
    significant = [
        estimate for estimate in estimates if estimate.sigmas > MAX_SIGMAS and estimate.nats > MAX_NATS
    ]
    return max(significant, key=lambda estimate: estimate.nats, default=None)


def warning_text(estimate: ScaleEstimate) -> str:
    """Return the warning as a text for readers."""
    digits = max(2, min(4, -math.floor(math.log10(estimate.standard_error))))
    return (
        f"{estimate.axis} encoder: it counts {estimate.scale:.{digits}f} ± "
        f"{estimate.standard_error:.{digits}f} (1 standard error) times what the rig's model predicts; "
        f"check {estimate.axis}_counts_per_rev and the rig's file"
    )


def check_flight(flight: Flight, rig: str) -> list[FlightFinding]:
    """Check the scales of all encoders with a finished flight.

    Parameters
    ----------
    flight : Flight
        A finished flight.
    rig : str
        Name of the rig that flew, or path of its rig file.

    Returns
    -------
    list of FlightFinding
        One for the encoder whose scale is most clearly wrong; empty if none is.

    Raises
    ------
    SimError
        The rig file cannot be read.
    """
    rig_file = load_rig(rig)
    model = model_named(rig_file.model or "multibody", effects_of(rig_file))
    wrong = wrong_scale(scales_of(flight, rig_file, model))
    if wrong is None:
        return []
    name = f"{wrong.axis}_encoder_scale"
    return [FlightFinding(name, wrong.scale, wrong.standard_error, warning_text(wrong))]
