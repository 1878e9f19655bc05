"""Known effects, hidden in logs of real flights, and the judgement of a diagnosis of such a flight.

A voltage of `V` that is logged as `V / (1 + a)` makes the rotor push as much as `1 + a` times the logged
voltage would give. Angles get an error between axis and encoder, and are quantised again.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from heli_host.data.arrays import Floats
from heli_host.data.flight import Flight
from heli_sim.rig import Rig

from heli_benchmark.judge import MAX_STD, RANDOM_TORQUE
from heli_benchmark.task import PARTS


@dataclass(frozen=True)
class KnownEffect:
    """An effect to hide."""

    id: str  # One of `HIDERS`
    size: float
    """Seconds (delay), radians (play, eccentricity), share of the *voltage* (asymmetry, step), or share of
    the voltage per second (fade)."""


def hide(flight: Flight, effect: KnownEffect, at_s: float, count_rad: Floats) -> Flight:
    """Change the log of a flight as if the rig had had an effect. Shapes: `count_rad` (3,)."""
    return HIDERS[effect.id](flight, effect.size, at_s, count_rad)


def _voltage_delay(flight: Flight, size: float, _at_s: float, _count_rad: Floats) -> Flight:
    """Log each voltage `size` seconds before it acts."""
    rows = round(size / flight.step_s)
    rows_left = slice(None, len(flight) - rows)
    elevation_rad, pitch_rad, travel_rad = flight.angles_rad[rows_left].T
    front_V, back_V = flight.front_V[rows:], flight.back_V[rows:]
    return Flight(
        flight.t_s[rows_left], front_V, back_V, elevation_rad, pitch_rad, travel_rad, meta=flight.meta
    )


def _thrust_asymmetry(flight: Flight, size: float, _at_s: float, _count_rad: Floats) -> Flight:
    return replace(flight, front_V=flight.front_V / (1.0 + size), back_V=flight.back_V / (1.0 - size))


def _thrust_step(flight: Flight, size: float, at_s: float, _count_rad: Floats) -> Flight:
    voltage_share = np.where(flight.t_s < at_s, 1.0, 1.0 - size)
    return replace(flight, front_V=flight.front_V / voltage_share)


def _fading_supply(flight: Flight, size: float, _at_s: float, _count_rad: Floats) -> Flight:
    voltage_share = 1.0 - size * flight.t_s
    return replace(flight, front_V=flight.front_V / voltage_share, back_V=flight.back_V / voltage_share)


def _encoder_play(flight: Flight, size: float, _at_s: float, count_rad: Floats) -> Flight:
    """Let the encoder of pitch follow the axis with a play of `size` rad."""
    encoder_rad, half_play_rad = np.empty(len(flight)), 0.5 * size
    shown_rad = float(flight.pitch_rad[0])
    for row, axis_rad in enumerate(flight.pitch_rad):
        shown_rad = min(max(shown_rad, axis_rad - half_play_rad), axis_rad + half_play_rad)
        encoder_rad[row] = shown_rad
    return replace(flight, pitch_rad=_rounded_to_counts(encoder_rad, count_rad[1]))


def _encoder_eccentricity(flight: Flight, size: float, _at_s: float, count_rad: Floats) -> Flight:
    shown_rad = flight.travel_rad + size * np.sin(flight.travel_rad)
    return replace(flight, travel_rad=_rounded_to_counts(shown_rad, count_rad[2]))


def _rounded_to_counts(angle_rad: Floats, count_rad: float) -> Floats:
    return np.asarray(np.round(angle_rad / count_rad) * count_rad)


HIDERS: Final[Mapping[str, Callable[[Flight, float, float, Floats], Flight]]] = {
    "input_delay": _voltage_delay,
    "thrust_asymmetry": _thrust_asymmetry,
    "thrust_step.front": _thrust_step,
    "thrust_fade": _fading_supply,
    "backlash.pitch": _encoder_play,
    "encoder_eccentricity.travel": _encoder_eccentricity,
}
HIDDEN_EFFECTS: Final[tuple[KnownEffect, ...]] = (
    KnownEffect("input_delay", 0.03),
    KnownEffect("input_delay", 0.06),
    KnownEffect("thrust_asymmetry", 0.05),
    KnownEffect("thrust_asymmetry", 0.1),
    KnownEffect("thrust_step.front", 0.08),
    KnownEffect("thrust_step.front", 0.16),
    KnownEffect("thrust_fade", 0.002),
    KnownEffect("thrust_fade", 0.004),
    KnownEffect("backlash.pitch", np.deg2rad(1.0)),
    KnownEffect("backlash.pitch", np.deg2rad(3.0)),
    KnownEffect("encoder_eccentricity.travel", np.deg2rad(1.0)),
    KnownEffect("encoder_eccentricity.travel", np.deg2rad(3.0)),
)
"""Six effects of two sizes each; chosen before any diagnosis was run on such a flight."""


Curve = Callable[[Floats], Floats]

NAMES: Final[Mapping[str, tuple[str, ...]]] = {
    "input_delay": ("input_delay", "rotor_lag_with_delay"),
    # Both voltages are divided by the same number, so a fading supply is the same change of the log.
    "thrust_fade": ("thrust_fade", "supply_fade"),
}
"""Names that describe the same change of the log; other effects have their own name only."""


@dataclass(frozen=True)
class HiddenResult:
    """Judgement of a diagnosis by one hidden effect."""

    effect: KnownEffect  # Hidden effect
    named: bool  # Whether a cause, or one that the diagnosis does not distinguish from it, is the effect
    undetectable: bool  # Whether the diagnosis declares that these flights could not show it
    size: float
    """size, std, truth: Estimate, standard error and truth in the unit of the cause; NaN if it is not named.
    """
    std: float
    truth: float
    confidence: float  # Confidence of the cause; NaN if it is not named
    new_names: tuple[tuple[str, float], ...]
    """Other causes that the unchanged flights do not have, with their confidence."""
    supported_names: tuple[str, ...] = ()
    """Those of the new names that the unchanged flights support too, although not enough to be named there.
    """

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
    """Judge one diagnosis. Shapes: `volts_V` (n, 2), `t_s` (n,)."""
    names = NAMES.get(effect.id, (effect.id,))
    reference_names = {name for cause in reference["causes"] for name in _indistinguishable_names(cause)}
    cause = next((cause for cause in result["causes"] if _stands_for(cause, names)), None)
    # Neither the hidden effect nor a cause in `reference`, the diagnosis of the unchanged flights.
    new_names = tuple(
        (other["effect"], other["confidence"])
        for other in result["causes"]
        if other is not cause
        and not {*_indistinguishable_names(other), *PARTS.get(other["effect"], ())} & reference_names
        and not other["effect"].startswith(RANDOM_TORQUE)
    )
    size = std = truth = confidence = float("nan")
    if cause is not None:
        confidence = cause["confidence"]
        if cause["effect"] in names:
            size, std = _size_and_error(cause, t_s)
            truth = _true_size(effect, cause["effect"], result, volts_V, t_s, rig) + _reference_size(
                reference, names, t_s
            )
    return HiddenResult(
        effect,
        named=cause is not None,
        undetectable=bool({*names} & {*result["undetectable"]}),
        size=size,
        std=std,
        truth=truth,
        confidence=confidence,
        new_names=new_names,
        supported_names=tuple(name for name, _ in new_names if _is_supported(name, reference)),
    )


def _is_supported(name: str, reference: Mapping[str, Any]) -> bool:
    """Whether the unchanged flights support an effect, although perhaps not enough to name it."""
    # They do if its last refit, together with all named causes, gained more evidence than its penalty.
    causes = {cause["effect"] for cause in reference["causes"]}
    rows = reference.get("ranking", ())
    last_named = max((row["round"] for row in rows if row["taken"] and row["candidate"] in causes), default=0)
    refits = [
        row
        for row in rows
        if row["candidate"] == name and row["train"] is not None and row["round"] > last_named
    ]
    return bool(refits) and bool(refits[-1]["train"] > refits[-1]["penalty"])


def _stands_for(cause: Mapping[str, Any], names: tuple[str, ...]) -> bool:
    """Whether a cause, or an effect that it is ambiguous with, has one of the `names`."""
    return bool({*names} & {cause["effect"], *cause["ambiguous_with"]})


def _indistinguishable_names(cause: Mapping[str, Any]) -> tuple[str, ...]:
    """Return the name of a cause, and all names that the diagnosis does not distinguish from it."""
    members = cause.get("family", {"members": ()})["members"]
    return (cause["effect"], *cause["ambiguous_with"], *members)


def _reference_size(reference: Mapping[str, Any], names: tuple[str, ...], t_s: Floats) -> float:
    """Return the size of the same cause in the unchanged flights; 0 if they do not have it."""
    return next(
        (_size_and_error(cause, t_s)[0] for cause in reference["causes"] if cause["effect"] in names), 0.0
    )


def _size_and_error(cause: Mapping[str, Any], t_s: Floats) -> tuple[float, float]:
    """Return the size and the standard error of a cause: [s], [rad] or a share."""
    # The size of a fade is the share that is lost at the mean time of the flight, because its two parameters,
    # rate and bend, compensate for each other.
    name, parameters = cause["effect"], cause["parameters"]

    def value_and_std(suffix: str) -> tuple[float, float]:
        estimate = parameters[f"{name.replace('.', '_')}_{suffix}"]
        return float(estimate["value"]), float(estimate["std"] or 0.0)

    if name in ("thrust_fade", "supply_fade"):
        (rate_per_s, std_per_s), middle_s = value_and_std("per_s"), float(np.mean(t_s))
        bend_per_s, _ = value_and_std("bend_per_s") if f"{name}_bend_per_s" in parameters else (0.0, 0.0)
        # The lost share is rate * (1 - exp(-bend t)) / bend, or rate * t without a bend.
        is_bent = abs(bend_per_s) > 1e-9
        effective_s = (1.0 - np.exp(-bend_per_s * middle_s)) / bend_per_s if is_bent else middle_s
        return float(rate_per_s * effective_s), float(std_per_s * abs(effective_s))
    if name.startswith("encoder_eccentricity"):
        # The hidden error is a pure sine; the cosine is zero.
        return value_and_std("sin_rad")
    suffix = {"input_delay": "s", "rotor_lag_with_delay": "delay_s", "backlash.pitch": "rad"}.get(
        name, "share"
    )
    return value_and_std(suffix)


def _true_size(
    effect: KnownEffect, name: str, result: Mapping[str, Any], volts_V: Floats, t_s: Floats, rig: Rig
) -> float:
    """Return the true size of the hidden effect in the unit of the cause `name`."""
    # Effects of the voltage were hidden as shares of it; most causes describe them as shares of the thrust.
    curve = steady_thrust(result, rig)
    if effect.id == "thrust_asymmetry":
        # The constant torques of a flight absorb the mean of the thrust: only its variation shows the factor.
        front = _thrust_variation_factor(curve, volts_V[:, 0], 1.0 + effect.size)
        back = _thrust_variation_factor(curve, volts_V[:, 1], 1.0 - effect.size)
        return (front - back) / (front + back)
    if effect.id == "thrust_step.front":
        return 1.0 - _thrust_factor(curve, volts_V[:, 0], 1.0 - effect.size)
    if effect.id == "thrust_fade":
        lost_share = effect.size * float(np.mean(t_s))  # as in `_size_and_error`
        if name == "supply_fade":
            return lost_share
        return 1.0 - _thrust_factor(curve, volts_V.mean(axis=1), 1.0 - lost_share)
    return effect.size  # a delay [s], play or eccentricity [rad]: the cause has the same unit


def _thrust_factor(curve: Curve, volts_V: Floats, volts_factor: float) -> float:
    """Return the least-squares factor of the thrust if all voltages are multiplied by `volts_factor`."""
    thrust = curve(volts_V)
    return float(thrust @ curve(volts_factor * volts_V) / (thrust @ thrust))


def _thrust_variation_factor(curve: Curve, volts_V: Floats, volts_factor: float) -> float:
    """Return the same factor for the deviations of the thrust from its mean."""
    # A constant difference between the rotors is no sign of an asymmetry, because each flight has its own
    # constant torques.
    thrust = curve(volts_V)
    thrust = thrust - thrust.mean()
    return float(thrust @ curve(volts_factor * volts_V) / (thrust @ thrust))


def steady_thrust(result: Mapping[str, Any], rig: Rig) -> Curve:
    """Return the steady thrust of the extended model as a function of the voltage, up to a factor."""
    numbers = result["rig"]["numbers"]

    def value(name: str) -> float:
        """Return a parameter as identified, or else as nominal."""
        return float(numbers[name]["value"] if name in numbers else rig[name].value)

    dead_zone_V, reverse = value("dead_zone"), value("reverse_thrust")
    causes = {cause["effect"]: cause["parameters"] for cause in result["causes"]}
    speed_lag = causes.get("rotor_speed_lag")
    quadratic = causes.get("thrust_quadratic")
    thrust_begins_V = dead_zone_V * (speed_lag["rotor_speed_lag_begins"]["value"] if speed_lag else 1.0)

    def curve(volts_V: Floats) -> Floats:
        """Return the thrust of each voltage, up to a common factor."""
        forward_V = np.maximum(volts_V - thrust_begins_V, 0.0)
        backward_V = np.maximum(-volts_V - thrust_begins_V, 0.0)
        if speed_lag:
            return np.asarray(forward_V**2 - reverse * backward_V**2)
        thrust = forward_V - reverse * backward_V
        if quadratic:
            pivot_V = quadratic.get("thrust_quadratic_pivot_V", {"value": 1.0})["value"]
            thrust = thrust * (
                1.0 + quadratic["thrust_quadratic_share"]["value"] * (np.abs(thrust) / pivot_V - 1.0)
            )
        return np.asarray(thrust)

    return curve
