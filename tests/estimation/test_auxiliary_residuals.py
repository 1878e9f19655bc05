"""Auxiliary residuals compared with brute force: a separate regressor for a shock at each instant."""

from __future__ import annotations

import numpy as np
import pytest
from heli_lab.fit.grey_box import DisturbanceModel
from heli_lab.fit.innovations import InnovationsModel, auxiliary_residuals
from heli_sim.model import MultibodyModel

from tests.estimation.made import RIG, flight_with_disturbances

DISTURBANCES = DisturbanceModel.start((0.012, 0.004, 0.008), (2e-3, 1e-3, 1e-3))


@pytest.fixture(scope="module")
def filtered() -> InnovationsModel:
    """A flight in disturbances, filtered at the nominal parameters."""
    from heli_lab.fit.estimator import _linearised
    from heli_lab.fit.flight_model import RigParameters, filter_record, model_functions

    model = MultibodyModel()
    parameters = RigParameters(model, RIG, [flight_with_disturbances()])
    functions = model_functions(model, parameters.quantities)
    return _linearised(parameters, [filter_record(flight_with_disturbances())], functions, parameters.start)


@pytest.mark.medium
@pytest.mark.parametrize("output", range(3))
def test_score_of_a_shock_is_that_of_its_regressor_at_every_instant(
    filtered: InnovationsModel, output: int
) -> None:
    (residuals,) = auxiliary_residuals(filtered, DISTURBANCES)
    (linearised,) = filtered.linearised_flights
    rows = np.concatenate([blocks.rows for blocks in linearised.blocks])
    innovations = filtered.innovations(DISTURBANCES).flights[0][:, 0]
    tested = np.arange(3, len(rows), 97)  # every 97th instant: all of them would take minutes
    steps = np.arange(linearised.rows)[:, None]
    # A level is a torque that acts from an instant on; an impulse acts in a single step. Shape (n, tested).
    torques_of_level, torques_of_impulse = steps >= rows[tested], steps == rows[tested]
    for shock, torques in (
        (residuals.level, torques_of_level),
        (residuals.impulse, torques_of_impulse),
    ):
        (regressors,) = filtered.disturbance_regressors(DISTURBANCES, output, [torques.astype(float)])
        score, information = regressors.T @ innovations, np.square(regressors).sum(axis=0)
        assert np.allclose(shock.information[tested, output], information, rtol=1e-7)
        assert np.allclose(shock.score[tested, output], score, rtol=1e-6, atol=1e-7 * np.abs(score).max())
        assert np.allclose(shock.t_statistic[tested, output], score / np.sqrt(information), atol=1e-6)
