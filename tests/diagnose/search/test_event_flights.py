"""Moments of events: an event of one flight may happen at another time in another flight, or never."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from heli_lab.explain.comparison import ModelComparison
from heli_lab.explain.screening import Screening
from heli_lab.explain.stepwise import with_held_out_moments
from heli_lab.fit.flight_model import RigParameters
from heli_lab.fit.problem import Problem
from heli_lab.fit.records import prepare
from heli_sim.model import MultibodyModel
from heli_sim.model.effect import NEVER_s
from heli_sim.model.effects import catalogue, parse_effects
from heli_sim.rig import load_rig

from tests.diagnose.hidden import flights

pytestmark = pytest.mark.diagnosis

RIG = load_rig("makki2024")
KIND = catalogue()["counterweight_shift"]
MOMENT_s, OTHER_s = 9.3, 6.2
SLIP_m = 0.02


@pytest.mark.medium
def test_moment_of_an_event_belongs_to_its_flight() -> None:
    records = [
        replace(prepare(flights("rotor_lag=0.1")[0], RIG, "x"), label=label) for label in ("a", "b", "c")
    ]
    effect = replace(KIND.make(KIND.typical), flight="a", other_moments_s={"b": 6.0})
    model = MultibodyModel((effect,))
    vector, problem = RigParameters(model, RIG, records), Problem(model, RIG, records)
    index_of_moment = model.parameter_names.index("counterweight_shift_at_s")
    for parameters in (vector, problem.parameter_vector):
        theta = parameters.started_from({"counterweight_shift_at_s": 11.0})
        source = vector if parameters is vector else problem
        moments_s = [source.parameters(theta, flight)[index_of_moment] for flight in range(3)]
        assert moments_s == [11.0, 6.0, NEVER_s]
    shared = MultibodyModel((replace(effect, flight=""),))
    theta = RigParameters(shared, RIG, records).started_from({"counterweight_shift_at_s": 11.0})
    assert RigParameters(shared, RIG, records).parameters(theta, 2)[index_of_moment] == 11.0


@pytest.mark.slow
@pytest.mark.parametrize("held_out_s", [None, OTHER_s])
def test_a_slip_is_found_in_the_flight_where_it_happened(held_out_s: float | None) -> None:
    fitted = flights(f"counterweight_shift={SLIP_m}@{MOMENT_s}")[0]
    other = flights(*([f"counterweight_shift={SLIP_m}@{held_out_s}"] if held_out_s else []))[1]
    comparison = ModelComparison(
        MultibodyModel(), RIG, [prepare(fitted, RIG, "a")], [prepare(other, RIG, "b")]
    )
    base = comparison.refit([])
    (scored,) = Screening(base.estimate).effects([KIND])
    assert scored.candidate.effect.flight == "a"
    refit = comparison.refit([scored.candidate], scored.candidate.start_values(scored.coefficients), base)
    # The clock of a log starts a little before that of the simulation.
    assert refit.values["counterweight_shift_at_s"] == pytest.approx(MOMENT_s, abs=0.2)
    final = with_held_out_moments(comparison, refit)
    moments_s = final.candidates[0].effect.other_moments_s
    if held_out_s is None:
        assert not moments_s
    else:
        assert moments_s["b"] == pytest.approx(held_out_s, abs=0.2)
    # If the event had the same moment in both flights, the held-out flight would contradict it.
    with_event, without_event = (
        comparison.held_out_estimate(model).log_likelihood for model in (final, base)
    )
    assert with_event > without_event + 10.0
    assert np.isfinite([with_event, without_event]).all()


def test_effects_without_a_flight_happen_in_every_flight() -> None:
    (effect,) = parse_effects(["counterweight_shift=0.01@12"])
    assert effect.values_in("any", effect.values) == dict(effect.values)
