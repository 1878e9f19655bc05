"""The flight that would tell more: plans for `heli-host fly`, put together from what has to be seen.

Which of them tells two hypotheses apart is not guessed: each plan is flown on the simulated rig with one of
them true, and the other one is fitted to that flight (`rehearsal.py`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Final

from heli_sim.errors import SimError
from heli_sim.model.effects import EffectKind

from heli_lab.diagnose.detectability import undetectable_effects
from heli_lab.diagnose.model_comparison import Comparison, Hypothesis
from heli_lab.diagnose.screening import Screening
from heli_lab.diagnose.simulated_experiment import separation, simulate_experiment

_PARTS: Final[Mapping[str, tuple[str, str]]] = {
    "motors": (
        "both motors shaken hard and fast, which shows how thrust follows voltage",
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
        "both motors shaken harder and faster for a minute, which tells a lag from a delay",
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
"""Parts of a plan: what each shows, and its segments."""
_USUAL: Final = ("motors", "travel", "elevation")
_TRIED: Final = ("motors", "fast", "travel", "elevation")
"""Parts that are rehearsed besides those of the two effects themselves."""
_CLEARLY: Final = 10.0
"""Times what is enough at which no other plan is rehearsed."""

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
    """A flight that would tell more.

    Parameters
    ----------
    why : str
        What it would tell.
    plan : str
        The plan, TOML, for `heli-host fly`.
    """

    why: str
    plan: str


def part_for(kind: EffectKind) -> str:
    """Which part of a plan shows an effect best.

    Parameters
    ----------
    kind : EffectKind
        The effect.

    Returns
    -------
    str
        Key of a part.
    """
    if any(q.name.endswith("_at_s") for q in kind.parameters) or "fade" in kind.id:
        return "time"
    axis = kind.acts_on.rpartition(".")[2]
    if axis in ("travel", "elevation"):
        return axis
    return "elevation" if kind.id == "ground_effect" else "motors"


def next_flight(reason: str, parts: Iterable[str]) -> ExperimentDesign:
    """Put a plan together.

    Parameters
    ----------
    reason : str
        Why another flight is needed, a sentence.
    parts : iterable of str
        Keys of the parts that it needs; all but the longest where there are none.

    Returns
    -------
    ExperimentDesign
        The flight.
    """
    chosen = [key for key in _PARTS if key in set(parts)] or list(_USUAL)
    return ExperimentDesign(f"{reason} Fly {_shows(chosen)}.", _plan(chosen))


@dataclass(frozen=True)
class Pair:
    """Two hypotheses that the flights given do not tell apart.

    Parameters
    ----------
    first, second : Hypothesis
        The models, fitted to the flights given.
    names : (str, str)
        Ids of the effects in which they differ.
    behind : float
        Logarithm of the likelihood ratio by which the second is behind on the flights given.
    """

    first: Hypothesis
    second: Hypothesis
    names: tuple[str, str]
    behind: float


def flight_that_separates(
    pair: Pair,
    comparison: Comparison,
    kinds: Mapping[str, EffectKind],
    enough: float,
    in_time: Callable[[], bool],
) -> ExperimentDesign:
    """Choose the plan that would tell two hypotheses apart best.

    Parameters
    ----------
    pair : Pair
        The hypotheses.
    comparison : Comparison
        Model and rig.
    kinds : Mapping[str, EffectKind]
        The catalogue.
    enough : float
        Logarithm of a likelihood ratio from which on two hypotheses are told apart.
    in_time : callable
        Whether there is time for another rehearsal.

    Returns
    -------
    ExperimentDesign
        The plan with the largest expected separation, none being tried after one that is plenty; where there
        was no time for any, the one that shows the two effects best by what they act on.
    """
    apart = (
        f"These flights do not tell {pair.names[0]} from {pair.names[1]}: their log-likelihoods differ by "
        f"{abs(pair.behind):.1f}, and {enough:.0f} are needed."
    )
    parts = [part_for(kinds[id_]) for id_ in pair.names if id_ in kinds]
    found: dict[str, float] = {}
    for key in dict.fromkeys((*parts, *_TRIED)):
        if not in_time() or max(found.values(), default=0.0) > _CLEARLY * enough:
            break
        expected_apart = separation(pair.first, pair.second, comparison, _plan([key]))
        if expected_apart is not None:
            found[key] = expected_apart
    if not found:
        return next_flight(apart, parts)
    best = max(found, key=lambda key: found[key])
    other = separation(pair.second, pair.first, comparison, _plan([best])) if in_time() else None
    expected = f"{found[best]:.0f} if it is {pair.names[0]}"
    if other is not None:
        expected += f" and {other:.0f} if it is {pair.names[1]}"
    return ExperimentDesign(
        f"{apart} Fly {_shows([best])}. Rehearsed on the simulated rig, this plan alone sets them apart by "
        f"{expected}; it does best of {len(found)} plans tried.",
        _plan([best]),
    )


def flight_that_shows(
    reason: str, unseen: Iterable[str], baseline: Hypothesis, kinds: Mapping[str, EffectKind]
) -> ExperimentDesign:
    """Choose the plan that shows effects which the flights given could not show, and say which it would.

    Parameters
    ----------
    reason : str
        Why another flight is needed, a sentence.
    unseen : iterable of str
        Ids of the effects.
    baseline : Hypothesis
        The refitted baseline, to rehearse the plan on.
    kinds : Mapping[str, EffectKind]
        The catalogue.

    Returns
    -------
    ExperimentDesign
        The plan, and how many of the effects it would show at a typical size.
    """
    asked = [kinds[id_] for id_ in unseen]
    flight = next_flight(reason, {part_for(kind) for kind in asked})
    record = simulate_experiment(baseline.fit, flight.plan)
    if record is None:
        return flight
    problem = baseline.fit.problem
    try:
        new = Comparison(problem.model, problem.rig, [record], ()).refit([], baseline.fit.values)
        still = undetectable_effects(Screening(new.fit).effects(asked), kinds)
    except SimError:
        return flight
    but = f", not {', '.join(still)}" if still else ""
    return ExperimentDesign(
        f"{flight.why} Rehearsed on the simulated rig, it shows {len(asked) - len(still)} of these "
        f"{len(asked)} at a typical size{but}.",
        flight.plan,
    )


def _plan(keys: Iterable[str]) -> str:
    return _HEAD + _BACK.join(_PARTS[key][1] for key in keys)


def _shows(keys: Iterable[str]) -> str:
    return "; ".join(_PARTS[key][0] for key in keys)
