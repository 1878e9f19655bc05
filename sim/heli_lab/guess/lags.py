"""Report delays between the columns of a file, such as voltages that were logged later than the angles."""

from __future__ import annotations

from heli_lab.guess import thresholds
from heli_lab.guess.regression.acceleration_fit import RegressionFit
from heli_lab.guess.regression.axis_regression import responds_without_lag
from heli_lab.guess.regression.scales import AXES
from heli_lab.guess.result import Ambiguity


def lag_ambiguities(regressions: dict[str, RegressionFit]) -> tuple[list[Ambiguity], str]:
    """List implausible delays between the columns as ambiguities.

    The guess removes no delay by itself, because a flight cannot separate a rotor lag from a late column.

    Parameters
    ----------
    regressions : dict of RegressionFit
        Regression of each axis' acceleration on its cause, by axis.

    Returns
    -------
    ambiguities : list of Ambiguity
        One per implausible delay.
    evidence : str
        A sentence with all delays.
    """
    ambiguities = []
    lag = {axis: regressions[axis].lag_s for axis in AXES}
    if abs(lag["travel"]) > thresholds.MAX_TRAVEL_LAG_S:
        ambiguities.append(
            Ambiguity(
                "travel's time",
                "not late",
                f"{lag['travel']:.2f} s late{_range_words(regressions['travel'])}",
                "it follows pitch at another time than a rig can; check how it is logged, and set delay_s",
            )
        )
    apart_s = lag["elevation"] - lag["pitch"]
    shortest_s, _ = regressions["elevation"].lag_range_s
    is_decisively_late = shortest_s > lag["pitch"]
    max_apart_s = thresholds.MAX_DECISIVE_LAG_S if is_decisively_late else thresholds.MAX_LAG_DIFFERENCE_S
    if abs(apart_s) > max_apart_s:
        possible = _range_words(regressions["elevation"], lag["pitch"])
        ambiguities.append(
            Ambiguity(
                "elevation's time",
                "logged with pitch",
                f"{abs(apart_s):.2f} s {'later' if apart_s > 0.0 else 'earlier'} than pitch{possible}",
                "the same rotors drive both, but a flight cannot separate their lag from a delay of the log; "
                "set delay_s only if your logger delays elevation",
            )
        )
    low, high = thresholds.PLAUSIBLE_LAGS_S
    without_lag = responds_without_lag(lag["pitch"])
    is_certain = without_lag and regressions["pitch"].no_rotor_lag_nats >= thresholds.DECISIVE_NATS
    if not low <= lag["pitch"] <= high and not is_certain:
        reason = (
            "pitch responds without a lag, as only a simulation without rotor lag does"
            if without_lag
            else "no rotor responds with such a lag"
        )
        ambiguities.append(
            Ambiguity(
                "the voltages' time",
                "logged with the angles",
                f"{'late' if lag['pitch'] < low else 'early'} by about "
                f"{abs(lag['pitch'] - 0.1):.2f} s relative to the angles",
                f"{reason}; check how they are logged, and set delay_s",
            )
        )
    sentence = (
        f"pitch follows the voltages after {lag['pitch']:.2f} s, elevation after {lag['elevation']:.2f} s "
        "(rotor lag, transport and logging delay; a flight cannot separate them); travel follows pitch "
        f"after {lag['travel']:.2f} s"
    )
    return ambiguities, sentence


def _range_words(fit: RegressionFit, origin_s: float = 0.0) -> str:
    """Describe the range of delays that a regression does not rule out, counted from `origin_s` [s]; empty if
    the range is short.
    """
    shortest_s, longest_s = (edge - origin_s for edge in fit.lag_range_s)
    if longest_s - shortest_s < thresholds.MAX_LAG_DIFFERENCE_S:
        return ""
    return f" ({shortest_s:.2f} to {longest_s:.2f} s are possible)"
