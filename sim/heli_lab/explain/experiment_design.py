"""The next experiment: plans that discriminate hypotheses or make effects detectable, for `heli-host fly`.

Plans consist of segments, each of which excites some effects. To discriminate two hypotheses, each plan is
flown on the simulated rig with one hypothesis true, and the other is fitted to that flight. The plan of the
largest expected log-likelihood ratio is proposed.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

from heli_host.data.flight import Flight
from heli_host.errors import HeliError
from heli_sim.errors import SimError
from heli_sim.model.base import Model
from heli_sim.model.effect import Stage
from heli_sim.model.effects import EffectSpec
from heli_sim.rig import Rig

from heli_lab.explain.assessment import Assessment
from heli_lab.explain.comparison import Hypothesis, ModelComparison, Refit
from heli_lab.explain.contributions import spline_curves_of
from heli_lab.explain.screening import Screening
from heli_lab.explain.stepwise import Search
from heli_lab.explain.thresholds import MANY_UNDETECTABLE, MIN_MARGIN, SHORT_s
from heli_lab.explain.verdict import undetectable_effects
from heli_lab.fit.estimator import Estimate
from heli_lab.fit.problem import free_parameters
from heli_lab.fit.records import Record, prepare

_DECIMATION: Final = 2
"""The board logs every millisecond; fits of every second sample are equally good and take half the time."""

_SEED: Final = 0
"""Seed of the encoders' start positions."""


def simulate_experiment(estimate: Estimate, plan: str) -> Record | None:
    """Fly a plan on the simulated rig."""
    # Board, link and simulation are 30 files, and most diagnoses propose no flight.
    from heli_host.board.rest_check import ANGLE_SHIFTED
    from heli_host.fly.plan import Plan
    from heli_host.fly.tracking import NOT_TRACKED
    from heli_sim.model.plant import Plant

    from heli_lab.simulated_board import connected, fly_and_read, set_hover, world_of

    parameter_vector = estimate.parameter_vector
    model = parameter_vector.model
    values = parameter_vector.shared_by_name(estimate.theta)
    rig = parameter_vector.rig.replace(
        **{name: value for name, value in values.items() if name in parameter_vector.rig}
    )
    effects = tuple(
        replace(effect, values={name: values.get(name, start) for name, start in effect.values.items()})
        for effect in model.effects
    )
    try:
        plant = Plant(type(model)(effects), rig, seed=_SEED)
        with connected(world_of(plant, _SEED)) as heli:
            set_hover(heli, model, rig)
            flight, summary = fly_and_read(heli, Plan.parse(plan, "next flight"))
        # The effect itself may keep an axis from its setpoint or its rest; such a flight is informative. So
        # is a flight that failed in its landing, after the plan.
        has_effect = summary.outcome.startswith((NOT_TRACKED, ANGLE_SHIFTED))
        has_landing = "landing" in summary.outcome
        if not (summary.completed or has_effect or has_landing):
            return None
        return prepare(_thinned(flight), rig, "simulated")
    except (HeliError, SimError):
        return None  # the rig cannot fly this plan


def expected_log_likelihood_ratio(
    truth: Hypothesis, alternative: Hypothesis, comparison: ModelComparison, plan: str
) -> float | None:
    """Simulate a plan under one hypothesis, and compare both hypotheses on that flight."""
    record = simulate_experiment(truth.estimate, plan)
    if record is None:
        return None
    new = ModelComparison(comparison.model, comparison.rig, [record], (), seed=comparison.seed)
    try:
        with_truth = new.refit(truth.candidates, truth.params)
        with_alternative = new.refit(alternative.candidates, alternative.params)
    except SimError:
        return None  # a refit diverged, so nothing can be compared
    return with_truth.log_likelihood - with_alternative.log_likelihood


def _thinned(flight: Flight) -> Flight:
    """Return every second sample of the angles, with the mean of both voltages."""
    rows = len(flight) // _DECIMATION * _DECIMATION
    mean_V = flight.voltages_V[:rows].reshape(-1, _DECIMATION, 2).mean(axis=1)
    decimated = slice(0, rows, _DECIMATION)
    return Flight(flight.t_s[decimated], mean_V[:, 0], mean_V[:, 1], *flight.angles_rad[decimated].T)


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
            break  # other plans need not be simulated
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
        refitted = comparison.refit([], baseline.params)
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


def propose_experiment(
    comparison: ModelComparison,
    search: Search,
    assessment: Assessment,
    kinds: Mapping[str, EffectSpec],
    undetectable: Sequence[str],
) -> ExperimentDesign | None:
    """Propose the next flight."""
    label = assessment.verdict.label
    pair = _closest_pair(comparison, search, assessment) if label == "ambiguous" else None
    if pair is not None:
        return discriminating_experiment(pair, comparison, kinds)
    if label == "unexplained":
        return _wider_range(search, assessment)
    seconds = sum(record.used_s for record in comparison.train)
    if seconds < SHORT_s or len(undetectable) > MANY_UNDETECTABLE:
        missing_effects = ", ".join(undetectable) or "small effects"
        return informative_experiment(
            f"{seconds:.0f} s of free flight are too short to show {missing_effects}.",
            undetectable,
            search.baseline,
            kinds,
        )
    return None


def _wider_range(search: Search, assessment: Assessment) -> ExperimentDesign:
    """Compose a flight over a wider range of the quantities on which the missing term depends."""
    unlisted = assessment.verdict.unlisted
    quantities = {cause.candidate.dependence.quantity for cause in unlisted}
    parts = {part for part in ("travel", "elevation", "time") if any(part in name for name in quantities)}
    if any("thrust" in name for name in quantities) or not quantities:
        parts.add("motors")
    covered = " and ".join(
        f"{curve.on} only from {curve.quantity[0]:.3g} to {curve.quantity[-1]:.3g} {curve.quantity_unit}"
        for curve in spline_curves_of(unlisted, search.final.estimate)
    )
    limit = f"These flights cover {covered}. " if covered else ""
    return compose_experiment(f"{limit}A wider range would show more of the missing term.", parts)


def _closest_pair(comparison: ModelComparison, search: Search, assessment: Assessment) -> Pair | None:
    """Return the extended model, and the same model with its least certain cause replaced by an
    alternative.
    """
    # The alternative is the closest one. The result is None if no cause is ambiguous, or if the search did
    # not refit the alternative.
    ambiguous_causes = [cause for cause in assessment.verdict.causes if cause.ambiguous_with]
    if not ambiguous_causes:
        return None
    least_certain = min(ambiguous_causes, key=lambda cause: cause.alternatives[0].log_likelihood_ratio)
    alternative = least_certain.alternatives[0]
    refit = _refit_of_round(search, least_certain.candidate.id, alternative.id)
    if refit is None:
        return None
    extended = assessment.extended
    other_causes = [other for other in extended.candidates if other.id != least_certain.candidate.id]
    with_alternative = refit.hypothesis
    if other_causes:
        with_alternative = comparison.refit(
            [*other_causes, refit.candidate], with_alternative.params, extended
        )
    ids = (least_certain.candidate.id, alternative.id)
    return Pair(extended, with_alternative, ids, alternative.log_likelihood_ratio)


def _refit_of_round(search: Search, accepted_id: str, candidate_id: str) -> Refit | None:
    """Return the refit of a candidate in the round that accepted another candidate; None without one."""
    for round_ in search.rounds:
        if round_.accepted_id != accepted_id:
            continue
        for refit in round_.refits:
            if refit.candidate.id == candidate_id:
                return refit
    return None


_LABEL: Final = "ambiguous"
"""Without excitation all effects, and none, are equally likely."""


@dataclass(frozen=True)
class InsufficientExcitation:
    """Result of a diagnosis of flights that excite nothing.

    Parameters
    ----------
    why : str
        What is wrong with the flights, and how to fix it.
    undetectable : tuple of str
        Ids of all effects that the model may have.
    unidentifiable : tuple of str
        Names of all free parameters of the rig.
    next_flight : ExperimentDesign
        Proposed experiment.
    rig, model : str
        Names of the rig and of the equations.
    """

    why: str
    undetectable: tuple[str, ...]
    unidentifiable: tuple[str, ...]
    next_flight: ExperimentDesign
    rig: str
    model: str

    @property
    def label(self) -> str:
        """The verdict, ``ambiguous``."""
        return _LABEL


def insufficient_excitation(
    why: str, model: Model, rig: Rig, kinds: Mapping[str, EffectSpec]
) -> InsufficientExcitation:
    """Make the result for flights without excitation.

    Parameters
    ----------
    why : str
        Message of `NotExcited`.
    """
    return InsufficientExcitation(
        why,
        tuple(sorted(id_ for id_, kind in kinds.items() if kind.suits(model))),
        tuple(parameter.quantity for parameter in free_parameters(model, rig, None, {})),
        compose_experiment("A rig that does not fly shows nothing.", ()),
        rig.name,
        model.name,
    )
