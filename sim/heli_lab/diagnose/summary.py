"""A diagnosis in sentences, for a terminal and for a page."""

from __future__ import annotations

from typing import Final

from heli_lab.diagnose import serialize
from heli_lab.diagnose.insufficient_excitation import InsufficientExcitation
from heli_lab.diagnose.result import Diagnosis

_WORTH_A_LINE: Final = 0.9
"""Ratio of errors below which a spline term's gain is told."""


_WEATHER_MIN: Final = 6.0
"""Log-likelihood ratio, nats, from which on the weather about an axis is told."""


def summary(result: Diagnosis | InsufficientExcitation) -> str:
    """What was found, in a sentence or two."""
    if isinstance(result, InsufficientExcitation):
        return f"Nothing can be said of what the model lacks: {result.why}."
    cut = "" if result.search.complete else " The work allowed ran out before everything was tried."
    return _found(result) + cut


def _found(result: Diagnosis) -> str:
    label = result.label
    where = "flights that no fit saw" if result.after.held_out_fit else "the flights that were fitted"
    text = "; ".join(one["sentence"] for one in serialize.causes(result))
    text = text[:1].upper() + text[1:]
    weather = f" What remains is weather: {weather_of(result)}." if label != "unexplained" else ""
    if label == "explained":
        return (
            "Nothing is missing that these flights could show: what the refitted baseline leaves on "
            f"{where} cannot be foretold.{weather}"
        )
    if label in ("cause_found", "ambiguous"):
        return f"{text}.{weather}"
    missing = serialize.unexplained(result) or {}
    depends = missing["correlates_with"][0]
    first = f"{text}. Besides, something" if text else "Something"
    return (
        f"{first} is missing that no effect of the catalogue explains: a curve of {depends} foretells the "
        f"motion about {missing['axis']} (log-likelihood ratio {missing['log_likelihood_gain']:.0f} nats)."
    )


def weather_of(result: Diagnosis) -> str:
    """The torques by chance about each axis in words."""
    parts = [
        f"gusts of {1e3 * one['gust_Nm']:.2g} mN m about {axis} that last {one['memory_s']:.1g} s"
        for axis, one in serialize.weather(result.residual_analysis).items()
        if one["log_likelihood_ratio"] > _WEATHER_MIN
    ]
    return ", ".join(parts) or "none that shows"


def lines(result: Diagnosis | InsufficientExcitation) -> list[str]:
    """Numbers behind the summary, a line each."""
    if isinstance(result, InsufficientExcitation):
        return [
            f"undetectable effects: {', '.join(result.undetectable)}",
            f"unidentifiable parameters: {', '.join(result.unidentifiable)}",
            f"next flight: {result.next_flight.why}",
        ]
    lines = []
    for cause in serialize.causes(result):
        others = cause["ambiguous_with"]
        unclear = f"; could as well be {', '.join(others)}" if others else ""
        lines.append(f"{cause['effect']} (confidence {cause['confidence']:.2f}{unclear})")
    lines.append(f"{result.metric}, before and after, and their ratio:")
    for axis, one in result.gains.items():
        low, high = one.interval95
        lines.append(
            f"  {axis:9}  {one.before_deg:<7.3g} {one.after_deg:<7.3g} {one.ratio:.2f} "
            f"({low:.2f} to {high:.2f})"
        )
    for curve in result.curves:
        lines.append(f"a curve in its place: {curve.what}")
    for axis, one in result.spline_gains.items():
        if one.ratio < _WORTH_A_LINE:
            lines.append(f"  with it {axis} is off by {one.after_deg:.3g} deg, ratio {one.ratio:.2f}")
    if result.next_flight is not None:
        lines.append(f"next flight: {result.next_flight.why}")
    elif result.undetectable:
        lines.append(f"at a typical size these flights would not show: {', '.join(result.undetectable)}")
    return lines + result.cautions
