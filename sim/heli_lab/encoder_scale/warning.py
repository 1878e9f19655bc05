"""Warn after a flight if an encoder seems to have wrong counts per turn, or if the flight does not fit its
rig for another reason that looks the same.

`check_flight` is an entry point ``heli_host.flight_checks``.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

from heli_host.flight import Flight
from heli_host.flight_checks import FlightFinding
from heli_sim.model.base import Model
from heli_sim.model.effects import EffectSpec, catalogue, effects_of
from heli_sim.model.named import model_named
from heli_sim.rig import load_rig

from heli_lab.encoder_scale.estimate import Explanation, ScaleEstimate, ScaleTest
from heli_lab.encoder_scale.flight_residuals import FlightInWeakForm

MAX_SIGMAS: Final = 3.0
"""Distance of a scale from 1, in standard errors, above which there is a warning."""
MAX_NATS: Final = 0.5 * MAX_SIGMAS**2
"""The same threshold as a log-likelihood ratio. Both must be exceeded: far from 1, a standard error may
be small although a scale of 1 fits as well."""


LEAD_NATS: Final = 6.0
"""Log-likelihood ratio by which the scale of an encoder must be more likely than everything else that
explains the flight, nats: 400 times. Lower: healthy encoders are named in the place of a supply that sags.
Higher: wrong encoders are not named."""
_MAX_NAMES: Final = 4
"""Most explanations that a text lists."""


def wrong_scale(estimates: Sequence[ScaleEstimate]) -> ScaleEstimate | None:
    """Return the encoder scale that differs from 1 most clearly; None if no difference is significant."""
    significant = [
        estimate
        for estimate in estimates
        if estimate.converged and estimate.sigmas > MAX_SIGMAS and estimate.nats > MAX_NATS
    ]
    return max(significant, key=lambda estimate: estimate.nats, default=None)


def rivals(wrong: ScaleEstimate, explanations: Sequence[Explanation]) -> list[Explanation]:
    """Return the explanations that are as likely as a wrong scale, the most likely first."""
    return [other for other in explanations if other.nats > wrong.nats - LEAD_NATS]


def finding_of(wrong: ScaleEstimate, explanations: Sequence[Explanation]) -> FlightFinding:
    """Return the finding for an encoder that counts otherwise than the rig's model predicts.

    It names the encoder only if none of the other `explanations` is as likely.
    """
    others = rivals(wrong, explanations)
    name = f"{wrong.axis}_motion" if others else f"{wrong.axis}_encoder_scale"
    text = common_text(wrong, others) if others else warning_text(wrong)
    return FlightFinding(name, wrong.scale, wrong.standard_error, text)


def warning_text(estimate: ScaleEstimate) -> str:
    """Return the warning that an encoder counts wrong, as a text for readers."""
    return (
        f"{estimate.axis} encoder: it counts {_ratio_text(estimate)} times what the rig's model predicts; "
        f"check {estimate.axis}_counts_per_rev and the rig's file"
    )


def common_text(wrong: ScaleEstimate, others: Sequence[Explanation]) -> str:
    """Return the warning that a flight does not fit its rig, for one of several reasons."""
    names = [_explanation_text(other) for other in others]
    if len(names) > _MAX_NAMES:
        names = [*names[: _MAX_NAMES - 1], f"{len(names) - _MAX_NAMES + 1} other effects of the catalogue"]
    if others[0].nats < wrong.nats + LEAD_NATS:
        names.append(f"{wrong.axis}_counts_per_rev")
    causes = f"{', '.join(names[:-1])} or {names[-1]}" if len(names) > 1 else names[0]
    return (
        f"{wrong.axis} moves {_ratio_text(wrong)} times as far as the rig's model predicts, because of "
        f"{causes}: this flight does not show which; check supply_V and the rig's file, or run heli-host "
        "diagnose"
        if len(names) > 1
        else f"{wrong.axis} moves {_ratio_text(wrong)} times as far as the rig's model predicts, probably "
        f"because of {causes}; check supply_V and the rig's file, or run heli-host diagnose"
    )


def _explanation_text(explanation: Explanation) -> str:
    """Name an explanation: an effect by its id, a supply with the factor on the voltages."""
    if explanation.name == "supply_V":
        return f"a wrong supply_V (the motors act as if they had {explanation.factor:.2g} times the voltage)"
    return explanation.name


def _ratio_text(estimate: ScaleEstimate) -> str:
    """Write a scale with its standard error."""
    digits = max(2, min(4, -math.floor(math.log10(estimate.standard_error))))
    return f"{estimate.scale:.{digits}f} ± {estimate.standard_error:.{digits}f} (1 standard error)"


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
        One if the scale of an encoder is clearly wrong, or seems to be; empty otherwise.

    Raises
    ------
    SimError
        The rig file cannot be read.
    """
    rig_file = load_rig(rig)
    model = model_named(rig_file.model or "multibody", effects_of(rig_file))
    test = ScaleTest(FlightInWeakForm(flight, rig_file, model))
    wrong = wrong_scale(test.estimates)
    if wrong is None:
        return []
    return [finding_of(wrong, test.explanations(possible_effects(model)))]


def possible_effects(model: Model) -> list[EffectSpec]:
    """Return the effects of the catalogue that a model may have in addition."""
    kinds = catalogue()
    present = {effect.name for effect in model.effects}
    return [
        kind
        for kind in kinds.values()
        if kind.id not in present
        and kind.suits(model)
        and all(kind.compatible_with(kinds[name]) for name in present if name in kinds)
    ]
