"""Flights, fits and gain checks as cases: equal settings give equal rows, other rigs give others."""

from __future__ import annotations

import pickle
from typing import Any

import numpy as np
import pytest
from heli_lab.apps.campaign import works
from heli_lab.fit.flight_model import model_functions
from heli_lab.fit.identification import identify
from heli_lab.fit.problem import Budget, Problem
from heli_lab.fit.records import prepare
from heli_lab.fit.shooting import solve
from heli_sim.model import MultibodyModel
from heli_sim.model.effects import parse_effects
from heli_sim.rig import load_rig

from tests.diagnose.hidden import flights
from tests.identify.made import thinned

MODEL = MultibodyModel(parse_effects(["rotor_lag=0.08", "coulomb_friction.travel=0.02"]))
HOVER = "title = 'Short'\n[start]\nsettle_s = 3\n[[segment]]\nkind = 'hold'\nduration_s = 6\n"


@pytest.fixture
def plan(tmp_path: Any) -> str:
    path = tmp_path / "short.toml"
    path.write_text(HOVER)
    return str(path)


@pytest.mark.medium
def test_a_flight_is_its_settings_and_nothing_else(plan: str) -> None:
    settings = {**works.DEFAULTS, "plan": plan, "draw": {"thrust_gain": {"share": 0.2}}}
    row, _ = works.fly(settings)
    assert row["outcome"] == "completed"
    assert 0.8 < float(row["drawn_thrust_gain"] or 0.0) / load_rig("makki2024")["thrust_gain"].value < 1.2
    assert 9.0 < float(row["duration_s"] or 0.0) < 40.0
    assert works.fly(settings)[0] == row
    other, _ = works.fly({**settings, "seed": 2})
    assert other["elevation_rms_deg"] != row["elevation_rms_deg"]
    late, _ = works.fly({**settings, "effects": ["rotor_lag=0.15"]})
    assert float(late["elevation_rms_deg"] or 0.0) > 1.1 * float(row["elevation_rms_deg"] or 0.0)


@pytest.mark.slow
def test_gains_without_margin_fail_where_the_defaults_fly(tmp_path: Any) -> None:
    bold = tmp_path / "bold.toml"
    bold.write_text("[parameters]\npitch_kp = 1.5\npitch_kd = 0.05\n")
    settings = {**works.DEFAULTS, "effects": ["rotor_lag"], "draw": {"rotor_lag": {"range": [0.1, 0.15]}}}
    good, detail = works.gains(settings)
    assert good["outcome"] == "completed"
    assert 0.1 <= float(detail["effects"][0].partition("=")[2]) <= 0.15
    assert good["drawn_rotor_lag"] == float(detail["effects"][0].partition("=")[2])
    bad, _ = works.gains({**settings, "params": str(bold)})
    assert bad["outcome"] != "completed"


@pytest.mark.slow
def test_a_fit_is_compared_with_the_rig_that_flew() -> None:
    settings = {**works.DEFAULTS, "plan": "identify", "validate": "sine", "draw": "tolerances", "seed": 3}
    row, detail = works.identify(settings)
    assert row["converged"] and row["outcome"]
    assert sum(name.startswith("drawn_") for name in row) > 10
    assert float(row["held_out_normalised"] or 9.9) < 1.1
    assert float(row["within_2_std"] or 0.0) > 0.8
    assert set(detail["standard_errors_off"]) <= set(detail["values"])


@pytest.mark.medium
def test_the_number_of_threads_changes_no_number() -> None:
    rig = load_rig("makki2024")
    record = prepare(thinned(flights("rotor_lag=0.08")[0], 2), rig, "a", stop_s=20.0)
    fitted_values = [
        identify(MultibodyModel(), rig, [record], free=["thrust_gain"], threads=threads).fit.params
        for threads in (1, 3)
    ]
    assert fitted_values[0] == fitted_values[1]


@pytest.mark.medium
def test_a_fit_that_was_pickled_predicts_the_same() -> None:
    rig = load_rig("makki2024")
    record = prepare(thinned(flights("rotor_lag=0.08")[0], 4), rig, "a", stop_s=16.0)
    problem = Problem(MultibodyModel(), rig, [record], free=["thrust_gain"], threads=1)
    fit = solve(problem, budget=Budget(max_evaluations=4), scatter=False)
    copied = pickle.loads(pickle.dumps(fit))
    assert copied.params == fit.params
    before, after = (each.problem.evaluation(0, each.theta, each.states[0]) for each in (fit, copied))
    assert np.array_equal(before.residual, after.residual)
    assert np.array_equal(before.normal_matrix, after.normal_matrix)
    functions = pickle.loads(pickle.dumps(model_functions(MODEL, ("thrust_gain", "rotor_lag_s"))))
    assert (functions.free, functions.extra_states) == (("thrust_gain", "rotor_lag_s"), 2)
    with pytest.raises(TypeError):
        pickle.loads(pickle.dumps(rig)).numbers["thrust_gain"] = rig["g"]
