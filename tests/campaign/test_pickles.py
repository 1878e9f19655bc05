"""Rigs, models, fits and diagnoses that a campaign sends can be pickled, and then give the same results."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from typing import TypeVar

import numpy as np
import pytest
from heli_lab.diagnose import diagnose, to_json
from heli_lab.fit.identify import Problem, prepare, solve
from heli_lab.fit.identify.estimation_problem import Budget
from heli_lab.fit.identify.flight_model import model_functions
from heli_lab.fit.identify.run import identify
from heli_sim.model import MultibodyModel
from heli_sim.model.effects import parse_effects
from heli_sim.rig import load_rig, rig_names

from tests.diagnose.hidden import flights
from tests.identify.made import thinned

T = TypeVar("T")
MODEL = MultibodyModel(parse_effects(["rotor_lag=0.08", "coulomb_friction.travel=0.02"]))
copied: Callable[[T], T] = lambda value: pickle.loads(pickle.dumps(value))  # noqa: E731 - one line, typed


@pytest.mark.parametrize("name", rig_names())
def test_a_rig_and_what_is_replaced_in_it(name: str) -> None:
    rig = load_rig(name)
    other = copied(rig.replace(thrust_gain=0.7))
    assert other == rig.replace(thrust_gain=0.7)
    with pytest.raises(TypeError):
        other.numbers["thrust_gain"] = rig["g"]  # type: ignore[index]


def test_a_model_with_its_effects_and_its_functions() -> None:
    other = copied(MODEL)
    assert other.effects == MODEL.effects
    assert other.parameters == MODEL.parameters
    functions = copied(model_functions(MODEL, ("thrust_gain", "rotor_lag_s")))
    assert functions.free == ("thrust_gain", "rotor_lag_s")
    assert functions.extra_states == 2


@pytest.mark.medium
def test_a_fit_predicts_what_it_predicted() -> None:
    rig = load_rig("makki2024")
    record = prepare(thinned(flights("rotor_lag=0.08")[0], 4), rig, "a", stop_s=16.0)
    fit = solve(
        Problem(MultibodyModel(), rig, [record], free=["thrust_gain"], threads=1),
        budget=Budget(max_evaluations=4),
        scatter=False,
    )
    other = copied(fit)
    assert other.values == fit.values
    assert other.problem.threads == 1
    before = fit.problem.evaluation(0, fit.theta, fit.states[0])
    after = other.problem.evaluation(0, other.theta, other.states[0])
    assert np.array_equal(before.residual, after.residual)
    assert np.array_equal(before.normal_matrix, after.normal_matrix)


@pytest.mark.medium
def test_the_number_of_threads_changes_no_number() -> None:
    rig = load_rig("makki2024")
    record = prepare(thinned(flights("rotor_lag=0.08")[0], 2), rig, "a", stop_s=20.0)
    fitted_values = [
        identify(MultibodyModel(), rig, [record], free=["thrust_gain"], threads=threads).fit.values
        for threads in (1, 3)
    ]
    assert fitted_values[0] == fitted_values[1]


@pytest.mark.diagnosis
def test_a_diagnosis_says_what_it_said() -> None:
    fit, held_out = (thinned(flight, 2) for flight in flights("rotor_lag=0.08"))
    rig = load_rig("makki2024")
    diagnosis = diagnose(MultibodyModel(), rig, [fit], [held_out], stop_s=25.0, refits=3, threads=1)
    other = copied(diagnosis)
    assert to_json(other) == to_json(diagnosis)
    assert other.rig("again") == diagnosis.rig("again")
