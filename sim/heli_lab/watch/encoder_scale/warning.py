"""Warn after a flight if an encoder seems to have wrong counts per turn, or if the flight does not fit its
rig for another reason that looks the same.

`check_flight` is an entry point ``heli_host.flight_checks``.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

from heli_host.data.flight import Flight
from heli_host.data.log.summary import FlightFinding
from heli_sim.model.base import Model
from heli_sim.model.effects import EffectSpec, catalogue, effects_of
from heli_sim.model.named import model_named
from heli_sim.rig import load_rig

from heli_lab.watch.encoder_scale.estimate import WRONG_SUPPLY, Explanation, ScaleEstimate, ScaleTest
from heli_lab.watch.encoder_scale.flight_residuals import FlightInWeakForm

MAX_SIGMAS: Final = 3.0
"""Distance of a scale from 1, in standard errors, above which there is a warning."""
MAX_NATS: Final = 0.5 * MAX_SIGMAS**2
"""The same threshold as a log-likelihood ratio. Both must be exceeded: far from 1, a standard error may
be small although a scale of 1 fits as well."""


LEAD_NATS: Final = MAX_NATS
"""Log-likelihood ratio by which the scale of an encoder must be more likely than everything else that
explains the flight, nats: what the scale adds to another explanation must be significant by itself. Lower:
healthy encoders are named in the place of a supply that sags. Higher: wrong encoders are not named."""
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


def finding_of(wrong: ScaleEstimate, explanations: Sequence[Explanation]) -> FlightFinding:
    """Return the finding for an encoder that counts otherwise than the rig's model predicts.

    It names the encoder only if none of the other `explanations` is as likely.
    """
    best_nats = max([wrong.nats, *(other.nats for other in explanations)])
    # What is not significant by itself explains nothing, even if the scale is hardly significant either.
    others = [other for other in explanations if other.nats > max(best_nats - LEAD_NATS, MAX_NATS)]
    is_encoder_likely = wrong.nats > best_nats - LEAD_NATS
    if not others:
        name = f"{wrong.axis}_encoder_scale"
        return FlightFinding(name, wrong.scale, wrong.standard_error, warning_text(wrong))
    text = common_text(wrong, others, is_encoder_likely)
    return FlightFinding(f"{wrong.axis}_motion", wrong.scale, wrong.standard_error, text)


def warning_text(estimate: ScaleEstimate) -> str:
    """Return the warning that an encoder counts wrong, as a text for readers."""
    return (
        f"{estimate.axis} encoder: it counts {_ratio_text(estimate)} times what the rig's model predicts; "
        f"check {estimate.axis}_counts_per_rev and the rig's file"
    )


def common_text(wrong: ScaleEstimate, others: Sequence[Explanation], is_encoder_likely: bool) -> str:
    """Return the warning that a flight does not fit its rig, for a reason that may be no encoder."""
    names = [_explanation_text(other) for other in others]
    if len(names) > _MAX_NAMES:
        names = [*names[: _MAX_NAMES - 1], f"{len(names) - _MAX_NAMES + 1} other effects of the catalogue"]
    if is_encoder_likely:
        names.append(f"{wrong.axis}_counts_per_rev")
    reasons = f"{', '.join(names[:-1])} or {names[-1]}" if len(names) > 1 else names[0]
    certainty = "this flight does not show which" if len(names) > 1 else "no encoder explains it as well"
    has_supply = any(other.name == WRONG_SUPPLY for other in others)
    remedy = "check supply_V and the rig's file" if has_supply else "find the cause with heli-host diagnose"
    return (
        f"{wrong.axis} moves {_ratio_text(wrong)} times as far as the rig's model predicts, probably because "
        f"of {reasons}: {certainty}; {remedy}"
    )


def _explanation_text(explanation: Explanation) -> str:
    """Name an explanation: an effect by its id, a supply with the factor on the voltages."""
    if explanation.name == WRONG_SUPPLY:
        return f"a wrong supply_V (the motors act as if they had {explanation.factor:.2g} times the voltage)"
    return explanation.name


def _ratio_text(estimate: ScaleEstimate) -> str:
    """Write a scale with its standard error."""
    digits = max(2, min(4, -math.floor(math.log10(estimate.standard_error))))
    return f"{estimate.scale:.{digits}f} ± {estimate.standard_error:.{digits}f} (1 standard error)"


def check_flight(flight: Flight, rig: str) -> list[FlightFinding]:
    """Check the scales of all encoders with a finished flight."""
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
