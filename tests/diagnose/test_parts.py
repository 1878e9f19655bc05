"""The parts of a diagnosis, each against something that knows better."""

from __future__ import annotations

import numpy as np
import pytest
from heli_host.fly.plan import Plan
from heli_lab.diagnose.disturbance_torque import estimate_disturbance
from heli_lab.diagnose.experiment_design import compose_experiment, segment_for
from heli_lab.diagnose.linearisation import Linearisation
from heli_lab.diagnose.model_comparison import Errors
from heli_lab.diagnose.score_test import ScoreTest
from heli_lab.diagnose.spline_term import KNOTS, bspline_basis, channel_quantity_pairs, knot_span
from heli_lab.identify import Fit, Problem, prepare, solve
from heli_sim.model import MultibodyModel
from heli_sim.model.effects import catalogue
from heli_sim.rig import load_rig

from tests.diagnose.hidden import flights

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def baseline() -> Fit:
    """The baseline on a flight with nothing hidden."""
    rig = load_rig("makki2024")
    return solve(Problem(MultibodyModel(), rig, [prepare(flights()[0], rig)]))


@pytest.mark.parametrize("name", ["thrust_gain", "L_phi", "friction_travel", "torque_pitch"])
def test_linearisation_responds_as_the_free_run_itself_does(baseline: Fit, name: str) -> None:
    linearisation = Linearisation(baseline)
    column = linearisation.parameter_response()[:, :, baseline.problem.names.index(name)]
    step = np.zeros(len(baseline.theta))
    step[baseline.problem.names.index(name)] = (
        1e-4 * baseline.problem.prior_std[baseline.problem.names.index(name)]
    )
    more, less = (
        baseline.problem.evaluation(
            0, baseline.theta + sign * step, baseline.states[0], fine=True, derivatives=False
        ).residual
        for sign in (1, -1)
    )
    blocks = ((less - more) / (2 * step.max())).reshape(linearisation.rows, -1, 3).mean(axis=1)
    assert np.sqrt(np.mean((column - blocks) ** 2)) < 0.02 * np.sqrt(np.mean(blocks**2))


def test_bspline_basis_has_a_sum_of_one_everywhere() -> None:
    values = np.linspace(-3.0, 5.0, 200)
    low, step = knot_span(values)
    assert bspline_basis(values, low, step).shape == (200, KNOTS)
    assert np.allclose(bspline_basis(values, low, step).sum(axis=1), 1.0)


def test_no_spline_of_a_measurement_on_thrust_is_tried() -> None:
    # The controller feeds the quantisation error back: such a term would be found in any flight.
    assert not [
        pair for pair in channel_quantity_pairs() if pair[0].startswith("measurement") and "thrust" in pair[1]
    ]


def test_missing_torque_is_the_torque_that_was_hidden() -> None:
    fit_flight, _ = flights(off_list=True)
    rig = load_rig("makki2024").replace(thrust_gain=0.62, friction_travel=0.05)
    fit = solve(Problem(MultibodyModel(), rig, [prepare(fit_flight, rig)], free=("offset_pitch",)))
    linearisation = Linearisation(fit)
    torque = estimate_disturbance(linearisation)
    truth = 0.05 * linearisation.trajectory.state[:, 0]
    found = torque.value_Nm[:, 1]
    assert np.corrcoef(truth, found)[0, 1] > 0.97
    assert np.sqrt(np.mean((truth - found) ** 2)) < 0.3 * truth.std()


def test_random_regressors_score_as_nothing(baseline: Fit) -> None:
    score_test = ScoreTest(baseline)
    random = np.random.default_rng(1)
    signal = random.standard_normal((score_test.linearisations[0].rows, 6, 3))
    signal[:, :3] = 0.0
    result = score_test.score([score_test.linearisations[0].response(signal)])
    assert result.log_likelihood_gain < 12.0
    assert np.all(np.abs(result.coefficients) < 5.0 * result.std)


def test_column_that_is_the_residual_scores_all_of_it(baseline: Fit) -> None:
    score_test = ScoreTest(baseline)
    column = score_test.linearisations[0].residual[:, :, None]
    result = score_test.score([column])
    assert result.coefficients[0] == pytest.approx(1.0, abs=0.1)
    assert result.log_likelihood_gain > 100.0


def test_the_axis_that_is_far_off_decides_where_a_model_is_wrong() -> None:
    def neg2_log_likelihood(pitch: float, travel: float) -> float:
        rows = np.array([200.0])
        squares = np.array([[1.0, pitch**2, travel**2]]) * rows[:, None]
        made = Errors(squares, rows, np.ones(3), 0.0, 1.0, np.ones(3), np.ones(3))
        return float(made.neg2_log_likelihood.sum())

    # Half of travel's error is nothing beside a tenth of a pitch error ten times as large.
    assert neg2_log_likelihood(pitch=45.0, travel=10.0) < neg2_log_likelihood(pitch=50.0, travel=5.0)
    # Where only quantisation is left, each axis counts for itself.
    assert neg2_log_likelihood(pitch=1.2, travel=1.0) - neg2_log_likelihood(
        pitch=1.0, travel=1.0
    ) == pytest.approx(2 * np.log(1.2))


@pytest.mark.parametrize("parts", [(), ("motors",), ("fast",), ("travel", "time"), ("elevation",)])
def test_next_flight_is_a_plan_that_can_be_flown(parts: tuple[str, ...]) -> None:
    flight = compose_experiment("Why.", parts)
    plan = Plan.parse(flight.plan, "next flight")
    plan.check()
    assert plan.duration_s > 20.0


def test_every_effect_has_a_part_that_shows_it() -> None:
    assert {segment_for(kind) for kind in catalogue().values()} == {"motors", "travel", "elevation", "time"}
