"""Experiment design: plans for `heli-host fly` that discriminate hypotheses or make effects detectable.

Plans consist of segments, each of which excites some effects. To discriminate two hypotheses, each plan is
flown on the simulated rig with one hypothesis true, and the other is fitted to that flight
(`simulation.py`). The plan of the largest expected log-likelihood ratio is proposed.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Final

from heli_sim.errors import SimError
from heli_sim.model.effect import Stage
from heli_sim.model.effects import EffectSpec

from heli_lab.explain.evaluate.detectability import undetectable_effects
from heli_lab.explain.experiment.simulation import expected_log_likelihood_ratio, simulate_experiment
from heli_lab.explain.search.hypothesis import Hypothesis
from heli_lab.explain.search.model_comparison import ModelComparison
from heli_lab.explain.search.screening import Screening
from heli_lab.explain.thresholds import MIN_MARGIN

_SEGMENTS: Final[Mapping[str, tuple[str, str]]] = {
    "motors": (
        "both motors excited up to 8 Hz, which shows how thrust follows voltage",
        """
[[segment]]
kind = "waypoints"
path = "straight"
points = [
  { at_s = 10, elevation_deg = 6, travel_deg = 30 },
  { at_s = 20, elevation_deg = -6, travel_deg = -30 },
  { at_s = 30, elevation_deg = 0, travel_deg = 0 },
]
duration_s = 30
excite = { signal = "prbs", front_V = 0.5, back_V = 0.5, stop_Hz = 8, seed = 3 }
""",
    ),
    "fast": (
        "both motors excited harder and up to 20 Hz for a minute, which distinguishes a lag from a delay",
        """
[[segment]]
kind = "hold"
duration_s = 60
excite = { signal = "prbs", front_V = 0.8, back_V = 0.8, stop_Hz = 20, seed = 5 }
""",
    ),
    "travel": (
        "travel far, fast and slow both ways, which distinguishes springs, tilt, drag and dry friction",
        """
[[segment]]
kind = "sine"
travel_amplitude_deg = 110
travel_period_s = 36
duration_s = 36
excite = { signal = "multisine", front_V = 0.15, back_V = 0.15, start_Hz = 0.1, stop_Hz = 2 }

[[segment]]
kind = "sine"
travel_amplitude_deg = 36
travel_period_s = 12
duration_s = 36
""",
    ),
    "elevation": (
        "elevation high and low, fast and slow, which distinguishes height, speed and friction",
        """
[[segment]]
kind = "sine"
elevation_amplitude_deg = 13
elevation_period_s = 20
duration_s = 40
excite = { signal = "multisine", front_V = 0.2, back_V = 0.2, start_Hz = 0.1, stop_Hz = 2 }

[[segment]]
kind = "sine"
elevation_amplitude_deg = 5
elevation_period_s = 7
duration_s = 28
""",
    ),
    "time": (
        "the same motion for two minutes, which distinguishes changes with time from changes with motion",
        """
[[segment]]
kind = "sine"
travel_amplitude_deg = 30
travel_period_s = 20
elevation_amplitude_deg = 5
elevation_period_s = 10
duration_s = 120
excite = { signal = "multisine", front_V = 0.25, back_V = 0.25, start_Hz = 0.1, stop_Hz = 4 }
""",
    ),
}
"""Segments of a plan by key: what they show, and their TOML. Amplitudes respect the rate limits of the
board."""
_DEFAULT: Final = ("motors", "travel", "elevation")
"""Segments of a plan if no others are requested: they excite every axis."""
_ALWAYS_TRIED: Final = ("motors", "fast", "travel", "elevation")
"""Segments that are simulated in addition to those of the two effects."""
_SUFFICIENT_MULTIPLE: Final = 10.0
"""Multiple of the needed log-likelihood ratio at which no further plan is simulated; only time depends on
it."""

_HEAD: Final = """title = "The flight that would show more"

[start]
elevation_deg = 0
rate_deg_s = 8
settle_s = 2
"""
_BACK: Final = """
[[segment]]
kind = "ramp"
elevation_deg = 0
travel_deg = 0
rate_deg_s = 8
"""


@dataclass(frozen=True)
class ExperimentDesign:
    """A proposed experiment: the reason `why` in sentences, and the `plan` as TOML for `heli-host fly`."""

    why: str
    plan: str


def segment_for(kind: EffectSpec) -> str:
    """Choose the segment that excites an effect of this `kind` best, by what it acts on; return its key."""
    if kind.time_varying:
        return "time"
    axis = kind.acts_on.rpartition(".")[2]
    if axis in ("travel", "elevation"):
        return axis
    return "elevation" if kind.stage is Stage.GROUND else "motors"


def compose_experiment(reason: str, parts: Iterable[str]) -> ExperimentDesign:
    """Compose a plan of segments."""
    chosen = [key for key in _SEGMENTS if key in set(parts)] or list(_DEFAULT)
    return ExperimentDesign(f"{reason} Fly {_purposes_text(chosen)}.", _plan_toml(chosen))


@dataclass(frozen=True)
class Pair:
    """Two hypotheses that the flights do not distinguish."""

    first: Hypothesis  # first, second: The hypotheses
    second: Hypothesis
    names: tuple[str, str]  # (str, str): Ids of the effects in which they differ
    log_likelihood_ratio: float
    """Ratio of the first over the second on these flights, penalties included, nats."""


def discriminating_experiment(
    pair: Pair, comparison: ModelComparison, kinds: Mapping[str, EffectSpec]
) -> ExperimentDesign:
    """Choose the plan of the largest expected log-likelihood ratio between two hypotheses."""
    reason = (
        f"These flights do not distinguish {pair.names[0]} from {pair.names[1]}: their log-likelihoods "
        f"differ by {abs(pair.log_likelihood_ratio):.1f}, and {MIN_MARGIN:.0f} are needed."
    )
    exciting_segments = [segment_for(kinds[id_]) for id_ in pair.names if id_ in kinds]
    # Expected log-likelihood ratio of each plan that can be flown, by its only segment.
    ratios: dict[str, float] = {}
    for key in dict.fromkeys((*exciting_segments, *_ALWAYS_TRIED)):
        if max(ratios.values(), default=0.0) > _SUFFICIENT_MULTIPLE * MIN_MARGIN:
            break
        ratio = expected_log_likelihood_ratio(pair.first, pair.second, comparison, _plan_toml([key]))
        if ratio is not None:
            ratios[key] = ratio
    if not ratios:
        return compose_experiment(reason, exciting_segments)
    best = max(ratios, key=lambda key: ratios[key])
    reverse_ratio = expected_log_likelihood_ratio(pair.second, pair.first, comparison, _plan_toml([best]))
    expected = f"{ratios[best]:.0f} if it is {pair.names[0]}"
    if reverse_ratio is not None:
        expected += f" and {reverse_ratio:.0f} if it is {pair.names[1]}"
    return ExperimentDesign(
        f"{reason} Fly {_purposes_text([best])}. Simulated on this rig, this plan alone gives a "
        f"log-likelihood ratio of {expected}; it is the best of {len(ratios)} plans tried.",
        _plan_toml([best]),
    )


def informative_experiment(
    reason: str, undetectable: Iterable[str], baseline: Hypothesis, kinds: Mapping[str, EffectSpec]
) -> ExperimentDesign:
    """Choose the plan that excites undetectable effects, and count those that it makes detectable."""
    wanted_kinds = [kinds[id_] for id_ in undetectable]
    flight = compose_experiment(reason, {segment_for(kind) for kind in wanted_kinds})
    record = simulate_experiment(baseline.estimate, flight.plan)
    if record is None:
        return flight
    parameter_vector = baseline.estimate.parameter_vector
    try:
        comparison = ModelComparison(parameter_vector.model, parameter_vector.rig, [record], ())
        refitted = comparison.refit([], baseline.values)
        missed = undetectable_effects(Screening(refitted.estimate).effects(wanted_kinds), kinds)
    except SimError:
        return flight
    exception_text = f", not {', '.join(missed)}" if missed else ""
    return ExperimentDesign(
        f"{flight.why} Simulated on this rig, it shows {len(wanted_kinds) - len(missed)} of these "
        f"{len(wanted_kinds)} at a typical size{exception_text}.",
        flight.plan,
    )


def _plan_toml(keys: Iterable[str]) -> str:
    """Return the TOML of a plan of some segments."""
    return _HEAD + _BACK.join(_SEGMENTS[key][1] for key in keys)


def _purposes_text(keys: Iterable[str]) -> str:
    """State what some segments show, in words."""
    return "; ".join(_SEGMENTS[key][0] for key in keys)
