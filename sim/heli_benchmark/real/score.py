"""Judge a diagnosis of a real flight in which one known effect was hidden.

A real machine has causes of its own. The diagnosis of the *unchanged* flights is therefore the reference: a
name that it has already is not a false name, and a size that it has already is added to the hidden one. A new
name is counted separately if the unchanged flights support it just below the level from which it is named.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from heli_host.arrays import Floats
from heli_sim.rig import Rig

from heli_benchmark.real.hide import KnownEffect
from heli_benchmark.scoring.judge import MAX_STD, RANDOM_TORQUE
from heli_benchmark.task.combined_causes import PARTS

Curve = Callable[[Floats], Floats]

NAMES: Final[Mapping[str, tuple[str, ...]]] = {
    "input_delay": ("input_delay", "rotor_lag_with_delay"),
    # Both voltages are divided by the same number, so a fading supply is the same change of the log.
    "thrust_fade": ("thrust_fade", "supply_fade"),
}
"""Names that describe the same change of the log; other effects have their own name only."""


@dataclass(frozen=True)
class HiddenResult:
    """Judgement of a diagnosis by one hidden effect.

    Parameters
    ----------
    effect : KnownEffect
        Hidden effect.
    named : bool
        Whether a cause, or one that the diagnosis does not distinguish from it, is the effect.
    undetectable : bool
        Whether the diagnosis declares that these flights could not show it.
    size, std, truth : float
        Estimate, standard error and truth in the unit of the cause; NaN if it is not named.
    confidence : float
        Confidence of the cause; NaN if it is not named.
    new_names : tuple of (str, float)
        Other causes that the unchanged flights do not have, with their confidence.
    supported_names : tuple of str
        Those of the new names that the unchanged flights support too, although not enough to be named there.
    """

    effect: KnownEffect
    named: bool
    undetectable: bool
    size: float
    std: float
    truth: float
    confidence: float
    new_names: tuple[tuple[str, float], ...]
    supported_names: tuple[str, ...] = ()

    @property
    def size_is_right(self) -> bool:
        """Whether the estimate is within `MAX_STD` standard errors of the truth."""
        return abs(self.size - self.truth) <= MAX_STD * self.std


def score(
    effect: KnownEffect,
    result: Mapping[str, Any],
    reference: Mapping[str, Any],
    volts_V: Floats,
    t_s: Floats,
    rig: Rig,
) -> HiddenResult:
    """Judge one diagnosis.

    Parameters
    ----------
    result, reference : Mapping[str, Any]
        JSON of the diagnosis with the hidden effect, and of the unchanged flights.
    volts_V : ndarray (n, 2)
        Voltages of the training flight as they are logged with the effect.
    t_s : ndarray (n,)
        Their times.
    rig : Rig
        Nominal rig of both diagnoses.
    """
    names = NAMES.get(effect.id, (effect.id,))
    known = {name for cause in reference["causes"] for name in _alike(cause)}
    cause = next((cause for cause in result["causes"] if _means(cause, names)), None)
    new_names = tuple(
        (other["effect"], other["confidence"])
        for other in result["causes"]
        if other is not cause
        and not {*_alike(other), *PARTS.get(other["effect"], ())} & known
        and not other["effect"].startswith(RANDOM_TORQUE)
    )
    size = std = truth = confidence = float("nan")
    if cause is not None:
        confidence = cause["confidence"]
        if cause["effect"] in names:
            size, std = _size(cause, t_s)
            truth = _truth(effect, cause["effect"], result, volts_V, t_s, rig) + _reference_size(
                reference, names, t_s
            )
    undetectable = bool({*names} & {*result["undetectable"]})
    supported_names = tuple(name for name, _ in new_names if _is_supported(name, reference))
    return HiddenResult(
        effect, cause is not None, undetectable, size, std, truth, confidence, new_names, supported_names
    )


def _is_supported(name: str, reference: Mapping[str, Any]) -> bool:
    """Whether the flights support an effect, although it may be below the level from which it is named: its
    last refit, together with all causes that are named, gained more than its penalty.
    """
    causes = {cause["effect"] for cause in reference["causes"]}
    rows = reference.get("ranking", ())
    last_named = max((row["round"] for row in rows if row["taken"] and row["candidate"] in causes), default=0)
    refits = [
        row
        for row in rows
        if row["candidate"] == name and row["train"] is not None and row["round"] > last_named
    ]
    return bool(refits) and bool(refits[-1]["train"] > refits[-1]["penalty"])


def _means(cause: Mapping[str, Any], names: tuple[str, ...]) -> bool:
    return bool({*names} & {cause["effect"], *cause["ambiguous_with"]})


def _alike(cause: Mapping[str, Any]) -> tuple[str, ...]:
    """Names that the diagnosis does not distinguish from a cause, its own included: a lag of the thrust
    replaces one of the rotor speed after small changes of the data.
    """
    members = cause.get("family", {"members": ()})["members"]
    return (cause["effect"], *cause["ambiguous_with"], *members)


def _reference_size(reference: Mapping[str, Any], names: tuple[str, ...], t_s: Floats) -> float:
    """Size that the unchanged flights have of the same cause; 0 without it."""
    return next((_size(cause, t_s)[0] for cause in reference["causes"] if cause["effect"] in names), 0.0)


def _size(cause: Mapping[str, Any], t_s: Floats) -> tuple[float, float]:
    """Size and standard error of a cause. For a fade this is the share that is lost in the middle of the
    flight: its two parameters compensate for each other.
    """
    name, numbers = cause["effect"], cause["parameters"]

    def number(suffix: str) -> tuple[float, float]:
        of = numbers[f"{name.replace('.', '_')}_{suffix}"]
        return float(of["value"]), float(of["std"] or 0.0)

    if name in ("thrust_fade", "supply_fade"):
        (rate, std), middle_s = number("per_s"), float(np.mean(t_s))
        bend = number("bend_per_s")[0] if f"{name}_bend_per_s" in numbers else 0.0
        course = (1.0 - np.exp(-bend * middle_s)) / bend if abs(bend) > 1e-9 else middle_s
        return float(rate * course), float(std * abs(course))
    if name.startswith("encoder_eccentricity"):
        # The hidden error is a pure sine; the cosine is zero.
        return number("sin_rad")
    suffix = {"input_delay": "s", "rotor_lag_with_delay": "delay_s", "backlash.pitch": "rad"}.get(
        name, "share"
    )
    return number(suffix)


def _truth(
    effect: KnownEffect, name: str, result: Mapping[str, Any], volts_V: Floats, t_s: Floats, rig: Rig
) -> float:
    """Size of the hidden effect in the measure of a cause: of thrust, where it is a share of the voltage."""
    curve = steady_thrust(result, rig)
    if effect.id == "thrust_asymmetry":
        front, back = (
            _slope(curve, volts_V[:, i], 1.0 + sign * effect.size) for i, sign in ((0, 1), (1, -1))
        )
        return (front - back) / (front + back)
    if effect.id == "thrust_step.front":
        return 1.0 - _gain(curve, volts_V[:, 0], 1.0 - effect.size)
    if effect.id == "thrust_fade":
        lost = effect.size * float(np.mean(t_s))
        return lost if name == "supply_fade" else 1.0 - _gain(curve, volts_V.mean(axis=1), 1.0 - lost)
    return effect.size


def _gain(curve: Curve, volts_V: Floats, factor: float) -> float:
    """Least-squares factor of the thrust, if the voltages are multiplied by a factor."""
    thrust = curve(volts_V)
    return float(thrust @ curve(factor * volts_V) / (thrust @ thrust))


def _slope(curve: Curve, volts_V: Floats, factor: float) -> float:
    """Least-squares factor of the thrust's variation, if the voltages are multiplied by a factor. A constant
    difference is no asymmetry: the constant torques of each flight are free.
    """
    thrust = curve(volts_V)
    thrust = thrust - thrust.mean()
    return float(thrust @ curve(factor * volts_V) / (thrust @ thrust))


def steady_thrust(result: Mapping[str, Any], rig: Rig) -> Curve:
    """Return the steady thrust of the extended model as a function of the voltage, up to a factor.

    Parameters
    ----------
    result : Mapping[str, Any]
        JSON of a diagnosis.
    rig : Rig
        Gives the dead zone where no flight determined it.
    """
    numbers = result["rig"]["numbers"]

    def value(name: str) -> float:
        return float(numbers[name]["value"] if name in numbers else rig[name].value)

    dead_zone_V, reverse = value("dead_zone"), value("reverse_thrust")
    causes = {cause["effect"]: cause["parameters"] for cause in result["causes"]}
    squared = causes.get("rotor_speed_lag")
    bent = causes.get("thrust_quadratic")
    begins_V = dead_zone_V * (squared["rotor_speed_lag_begins"]["value"] if squared else 1.0)

    def curve(volts_V: Floats) -> Floats:
        forward_V = np.maximum(volts_V - begins_V, 0.0)
        backward_V = np.maximum(-volts_V - begins_V, 0.0)
        if squared:
            return np.asarray(forward_V**2 - reverse * backward_V**2)
        thrust = forward_V - reverse * backward_V
        if bent:
            pivot_V = bent.get("thrust_quadratic_pivot_V", {"value": 1.0})["value"]
            thrust = thrust * (
                1.0 + bent["thrust_quadratic_share"]["value"] * (np.abs(thrust) / pivot_V - 1.0)
            )
        return np.asarray(thrust)

    return curve
