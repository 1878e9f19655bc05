"""Report delays between the columns of a file, such as voltages that were logged later than the angles."""

from __future__ import annotations

from heli_lab.setup.guess import thresholds
from heli_lab.setup.guess.regression.acceleration_fit import RegressionFit
from heli_lab.setup.guess.regression.axis_regression import responds_without_lag
from heli_lab.setup.guess.regression.scales import AXES
from heli_lab.setup.guess.result import Ambiguity

_TYPICAL_LAG_s = 0.1
"""Lag of an ordinary rotor, for the message how late or early the voltages are."""


def lag_ambiguities(regressions: dict[str, RegressionFit]) -> tuple[list[Ambiguity], str]:
    """List implausible delays between the columns as ambiguities. Returns `ambiguities`, `evidence`.

    The guess removes no delay by itself, because a flight cannot separate a rotor lag from a late column.
    """
    possible = (
        _travel_delay(regressions),
        _elevation_delay(regressions),
        _voltage_delay(regressions["pitch"]),
    )
    lag_s = {axis: regressions[axis].lag_s for axis in AXES}
    sentence = (
        f"pitch follows the voltages after {lag_s['pitch']:.2f} s, elevation after "
        f"{lag_s['elevation']:.2f} s (rotor lag, transport and logging delay; a flight cannot separate "
        f"them); travel follows pitch after {lag_s['travel']:.2f} s"
    )
    return [ambiguity for ambiguity in possible if ambiguity], sentence


def _travel_delay(regressions: dict[str, RegressionFit]) -> Ambiguity | None:
    """Return an ambiguity if travel follows pitch at an implausible time, otherwise None."""
    lag_s = regressions["travel"].lag_s
    if abs(lag_s) <= thresholds.MAX_TRAVEL_LAG_S:
        return None
    return Ambiguity(
        "travel's time",
        "not late",
        f"{lag_s:.2f} s late{_range_words(regressions['travel'])}",
        "it follows pitch at another time than a rig can; check how it is logged, and set delay_s",
    )


def _elevation_delay(regressions: dict[str, RegressionFit]) -> Ambiguity | None:
    """Return an ambiguity if elevation follows the voltages at another time than pitch, otherwise None."""
    elevation, pitch_lag_s = regressions["elevation"], regressions["pitch"].lag_s
    apart_s = elevation.lag_s - pitch_lag_s
    shortest_s, _ = elevation.lag_range_s
    is_decisively_late = shortest_s > pitch_lag_s
    max_apart_s = thresholds.MAX_DECISIVE_LAG_S if is_decisively_late else thresholds.MAX_LAG_DIFFERENCE_S
    if abs(apart_s) <= max_apart_s:
        return None
    return Ambiguity(
        "elevation's time",
        "logged with pitch",
        f"{abs(apart_s):.2f} s {'later' if apart_s > 0.0 else 'earlier'} than pitch"
        f"{_range_words(elevation, pitch_lag_s)}",
        "the same rotors drive both, but a flight cannot separate their lag from a delay of the log; "
        "set delay_s only if your logger delays elevation",
    )


def _voltage_delay(pitch: RegressionFit) -> Ambiguity | None:
    """Return an ambiguity if `pitch` follows the voltages with a lag that no rotor has, otherwise None."""
    shortest_s, longest_s = thresholds.PLAUSIBLE_LAGS_S
    without_lag = responds_without_lag(pitch.lag_s)
    is_certain = without_lag and pitch.no_rotor_lag_nats >= thresholds.DECISIVE_NATS
    if shortest_s <= pitch.lag_s <= longest_s or is_certain:
        return None
    reason = (
        "pitch responds without a lag, as only a simulation without rotor lag does"
        if without_lag
        else "no rotor responds with such a lag"
    )
    return Ambiguity(
        "the voltages' time",
        "logged with the angles",
        f"{'late' if pitch.lag_s < shortest_s else 'early'} by about "
        f"{abs(pitch.lag_s - _TYPICAL_LAG_s):.2f} s relative to the angles",
        f"{reason}; check how they are logged, and set delay_s",
    )


def _range_words(fit: RegressionFit, origin_s: float = 0.0) -> str:
    """Describe the range of delays that a regression does not rule out, counted from `origin_s` [s]; empty if
    the range is short.
    """
    shortest_s, longest_s = (edge - origin_s for edge in fit.lag_range_s)
    if longest_s - shortest_s < thresholds.MAX_LAG_DIFFERENCE_S:
        return ""
    return f" ({shortest_s:.2f} to {longest_s:.2f} s are possible)"
