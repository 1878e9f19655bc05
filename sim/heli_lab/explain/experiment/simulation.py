"""Simulated experiments: the flight code flies a plan on the simulated board, with the estimated rig."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

from heli_host.board.rest_check import ANGLE_SHIFTED
from heli_host.data.flight import Flight
from heli_host.errors import HeliError
from heli_host.fly.plan import Plan
from heli_host.fly.tracking import NOT_TRACKED
from heli_sim.errors import SimError
from heli_sim.plant import Plant

from heli_lab.explain.search.hypothesis import Hypothesis
from heli_lab.explain.search.model_comparison import ModelComparison
from heli_lab.fit.estimator import Estimate
from heli_lab.fit.records import Record, prepare
from heli_lab.simulated_board import connected, fly_and_read, set_hover, world_of

_DECIMATION: Final = 2
"""The board logs every millisecond; fits of every second sample are equally good and take half the time."""

_SEED: Final = 0
"""Seed of the encoders' start positions."""


def simulate_experiment(estimate: Estimate, plan: str) -> Record | None:
    """Fly a plan on the simulated rig."""
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
        # The effect itself may keep an axis from its setpoint or its rest; such a flight is informative.
        is_informative = summary.completed or summary.outcome.startswith((NOT_TRACKED, ANGLE_SHIFTED))
        if not is_informative and "landing" not in summary.outcome:
            return None
        return prepare(_thinned(flight), rig, "simulated")
    except (HeliError, SimError):
        return None


def expected_log_likelihood_ratio(
    truth: Hypothesis, alternative: Hypothesis, comparison: ModelComparison, plan: str
) -> float | None:
    """Simulate a plan under one hypothesis, and compare both hypotheses on that flight."""
    record = simulate_experiment(truth.estimate, plan)
    if record is None:
        return None
    new = ModelComparison(comparison.model, comparison.rig, [record], (), seed=comparison.seed)
    try:
        with_truth = new.refit(truth.candidates, truth.values)
        with_alternative = new.refit(alternative.candidates, alternative.values)
    except SimError:
        return None
    return with_truth.log_likelihood - with_alternative.log_likelihood


def _thinned(flight: Flight) -> Flight:
    """Return every second sample of the angles, with the mean of both voltages."""
    rows = len(flight) // _DECIMATION * _DECIMATION
    mean_V = flight.voltages_V[:rows].reshape(-1, _DECIMATION, 2).mean(axis=1)
    decimated = slice(0, rows, _DECIMATION)
    return Flight(flight.t_s[decimated], mean_V[:, 0], mean_V[:, 1], *flight.angles_rad[decimated].T)
