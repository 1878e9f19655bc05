"""Experiment design: plans for `heli-host fly` that separate hypotheses or show what is undetectable.

Plans are put together from segments, each of which excites some effects. To discriminate two hypotheses, each
plan is flown on the simulated rig with one of them true, and the other is fitted to that flight
(`simulated_experiment.py`): the plan of the largest expected log-likelihood ratio is proposed.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Final

from heli_sim.errors import SimError
from heli_sim.model.effects import EffectKind

from heli_lab.diagnose.detectability import undetectable_effects
from heli_lab.diagnose.model_comparison import Hypothesis, ModelComparison
from heli_lab.diagnose.screening import Screening
from heli_lab.diagnose.simulated_experiment import expected_log_likelihood_ratio, simulate_experiment

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
        "both motors excited harder and up to 20 Hz for a minute, which tells a lag from a delay",
        """
[[segment]]
kind = "hold"
duration_s = 60
excite = { signal = "prbs", front_V = 0.8, back_V = 0.8, stop_Hz = 20, seed = 5 }
""",
    ),
    "travel": (
        "travel far, fast and slow both ways, which tells springs, tilt, drag and dry friction apart",
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
        "elevation high and low, fast and slow, which tells height, speed and friction apart",
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
        "the same motion for two minutes, which tells what changes with time from what changes with motion",
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
"""Segments of a plan by key: what they show, and their TOML. Amplitudes keep within the board's limits of
rates."""
_DEFAULT: Final = ("motors", "travel", "elevation")
_ALSO_TRIED: Final = ("motors", "fast", "travel", "elevation")
"""Segments that are simulated besides those of the two effects themselves."""
_PLENTY: Final = 10.0
"""Times the log-likelihood ratio needed at which no further plan is simulated; only time depends on it."""

_HEAD: Final = """title = "The flight that would tell more"

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
    """An experiment that would tell more: `why`, and the `plan`, TOML for `heli-host fly`."""

    why: str
    plan: str


def segment_for(kind: EffectKind) -> str:
    """Choose the segment of a plan that excites an effect best, by what the effect acts on."""
    if any(q.name.endswith("_at_s") for q in kind.parameters) or "fade" in kind.id:
        return "time"
    axis = kind.acts_on.rpartition(".")[2]
    if axis in ("travel", "elevation"):
        return axis
    return "elevation" if kind.id == "ground_effect" else "motors"


def compose_experiment(reason: str, parts: Iterable[str]) -> ExperimentDesign:
    """Put a plan together from the segments of the keys in `parts`, or without any from those that excite
    every axis; `reason` is a sentence that says why another flight is needed.
    """
    chosen = [key for key in _SEGMENTS if key in set(parts)] or list(_DEFAULT)
    return ExperimentDesign(f"{reason} Fly {_shows(chosen)}.", _plan(chosen))


@dataclass(frozen=True)
class Pair:
    """Two hypotheses that the flights do not tell apart.

    Parameters
    ----------
    names : (str, str)
        Ids of the effects in which they differ.
    log_likelihood_ratio : float
        Of the first over the second on these flights, penalties included, nats.
    """

    first: Hypothesis
    second: Hypothesis
    names: tuple[str, str]
    log_likelihood_ratio: float


def discriminating_experiment(
    pair: Pair,
    comparison: ModelComparison,
    kinds: Mapping[str, EffectKind],
    enough: float,
) -> ExperimentDesign:
    """Choose the plan of the largest expected log-likelihood ratio between two hypotheses; where none can be
    flown, the one that excites the two effects best by what they act on.

    Parameters
    ----------
    enough : float
        Log-likelihood ratio from which on two hypotheses count as told apart, nats.
    """
    apart = (
        f"These flights do not tell {pair.names[0]} from {pair.names[1]}: their log-likelihoods differ by "
        f"{abs(pair.log_likelihood_ratio):.1f}, and {enough:.0f} are needed."
    )
    parts = [segment_for(kinds[id_]) for id_ in pair.names if id_ in kinds]
    values: dict[str, float] = {}
    for key in dict.fromkeys((*parts, *_ALSO_TRIED)):
        if max(values.values(), default=0.0) > _PLENTY * enough:
            break
        expected_apart = expected_log_likelihood_ratio(pair.first, pair.second, comparison, _plan([key]))
        if expected_apart is not None:
            values[key] = expected_apart
    if not values:
        return compose_experiment(apart, parts)
    best = max(values, key=lambda key: values[key])
    other = expected_log_likelihood_ratio(pair.second, pair.first, comparison, _plan([best]))
    expected = f"{values[best]:.0f} if it is {pair.names[0]}"
    if other is not None:
        expected += f" and {other:.0f} if it is {pair.names[1]}"
    return ExperimentDesign(
        f"{apart} Fly {_shows([best])}. Simulated on this rig, this plan alone sets them apart by "
        f"{expected}; it does best of {len(values)} plans tried.",
        _plan([best]),
    )


def informative_experiment(
    reason: str, undetectable: Iterable[str], baseline: Hypothesis, kinds: Mapping[str, EffectKind]
) -> ExperimentDesign:
    """Choose the plan that excites undetectable effects, and count those that would be significant in it at a
    typical size.

    Parameters
    ----------
    reason : str
        Why another flight is needed, a sentence.
    undetectable : iterable of str
        Ids of the effects.
    baseline : Hypothesis
        The refitted baseline, to simulate the plan with.
    """
    wanted = [kinds[id_] for id_ in undetectable]
    flight = compose_experiment(reason, {segment_for(kind) for kind in wanted})
    record = simulate_experiment(baseline.estimate, flight.plan)
    if record is None:
        return flight
    parameter_vector = baseline.estimate.parameter_vector
    try:
        new = ModelComparison(parameter_vector.model, parameter_vector.rig, [record], ()).refit(
            [], baseline.values
        )
        still = undetectable_effects(Screening(new.estimate).effects(wanted), kinds)
    except SimError:
        return flight
    but = f", not {', '.join(still)}" if still else ""
    return ExperimentDesign(
        f"{flight.why} Simulated on this rig, it shows {len(wanted) - len(still)} of these "
        f"{len(wanted)} at a typical size{but}.",
        flight.plan,
    )


def _plan(keys: Iterable[str]) -> str:
    return _HEAD + _BACK.join(_SEGMENTS[key][1] for key in keys)


def _shows(keys: Iterable[str]) -> str:
    return "; ".join(_SEGMENTS[key][0] for key in keys)
