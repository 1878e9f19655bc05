"""The estimation works for other machines than helicopters: it identifies a cart with a pendulum."""

from __future__ import annotations

import numpy as np
import pytest
from heli_lab.fit.estimator import estimate
from heli_lab.fit.innovations import refiltered
from heli_lab.fit.model_functions import ModelFunctions
from heli_lab.fit.parameters import FreeParameter, NormalPrior, ParameterVector
from heli_lab.fit.reference_trajectory import KinematicModel, kinematic_filter

from tests.estimation.pendulum import MODEL, PARAMETERS, TRUE, run

pytestmark = pytest.mark.medium
KINEMATICS = KinematicModel(20.0, 0.1, 2.0, 0.1)


@pytest.mark.slow
def test_a_cart_with_a_pendulum_is_identified_within_its_standard_errors() -> None:
    runs = [run(1), run(2)]
    guess = {name: 1.3 * value for name, value in TRUE.items()}
    shared = [FreeParameter(name, "", NormalPrior(value, value, 1e-4), name) for name, value in guess.items()]
    per_run = [FreeParameter(name, "", NormalPrior(0.0, 0.1), name) for name in ("force_N", "torque_Nm")]
    vector = ParameterVector(
        PARAMETERS,
        np.array([*guess.values(), 0.0, 0.0]),
        shared,
        per_run,
        [recording.label for recording in runs],
    )
    assert vector.names[4:] == ("force_N[run 1]", "torque_Nm[run 1]", "force_N[run 2]", "torque_Nm[run 2]")
    functions = ModelFunctions(MODEL, vector.quantities)
    references = [kinematic_filter(recording, KINEMATICS) for recording in runs]
    first = estimate(vector, references, functions, vector.start)
    references = refiltered(first.filtered(), first.disturbances)
    second = estimate(vector, references, functions, first.theta, first.disturbances)
    truth = np.array([*TRUE.values()])
    std = np.sqrt(np.diag(second.covariance))[: len(TRUE)]
    standardised_errors = (second.theta[: len(TRUE)] - truth) / std
    assert second.converged
    assert np.abs(standardised_errors).max() < 3.0
    assert (std / truth).max() < 0.1
    # The disturbances that were added: 0.08 N and 4 mN m, correlated over 0.25 s.
    assert second.disturbances.fast_std == pytest.approx([0.08, 0.004], rel=0.3)


def test_impossible_parameters_have_minus_infinite_likelihood() -> None:
    shared = [FreeParameter(name, "", NormalPrior(value, value, 1e-4), name) for name, value in TRUE.items()]
    recording = run(1)
    start = np.array([*TRUE.values(), 0.0, 0.0])
    vector = ParameterVector(PARAMETERS, start, shared, [], [recording.label])
    functions = ModelFunctions(MODEL, vector.quantities)
    reference = kinematic_filter(recording, KINEMATICS)
    impossible = np.where(np.array(vector.names) == "length_m", np.nan, vector.start)
    worst = estimate(vector, [reference], functions, impossible)
    assert worst.log_likelihood == -np.inf
    assert not worst.converged
