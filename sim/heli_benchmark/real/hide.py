"""Hide a known effect in a logged flight: change the log as if the rig had had the effect.

A voltage of `V` that is logged as `V / (1 + a)` makes the rotor push as much as `1 + a` times the logged
voltage would give. Angles get an error between axis and encoder, and are quantised again.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from heli_host.data.arrays import Floats
from heli_host.data.flight import Flight


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
