"""The search maximises each output's own likelihood by its disturbance, and the sum of all by a gain's."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from heli_host.arrays import Floats
from heli_lab.estimation import DisturbanceModel, GainDisturbance
from heli_lab.estimation.disturbance_search import maximise

START = DisturbanceModel.start((0.01, 0.02), (0.001, 0.002)).with_gains(1)
MAXIMUM = DisturbanceModel(
    np.array([0.02, 0.01]),
    np.array([0.2, 1.0]),
    np.array([0.003, 0.001]),
    np.array([1.0, 0.3]),
    (GainDisturbance(0.05, 2.0),),
)


def likelihoods(models: Sequence[DisturbanceModel]) -> Floats:
    """Quadratic likelihoods of two outputs. The gain changes them by unequal and opposite amounts, whose sum
    is largest at its `MAXIMUM`.
    """
    values = []
    for model in models:
        off = model.logarithms - MAXIMUM.logarithms
        of_outputs = -20.0 * (off[:8].reshape(2, 4) ** 2).sum(axis=1)
        values.append(
            of_outputs + np.array([-30.0, 10.0]) * (off[8:] ** 2).sum() + off[8] * np.array([3.0, -3.0])
        )
    return np.array(values)


def test_the_maximum_of_outputs_and_gains_is_found() -> None:
    estimate = maximise(likelihoods, START, (1e-5, 1.0))
    assert estimate.logarithms == pytest.approx(MAXIMUM.logarithms, abs=0.03)


def test_estimated_disturbances_stay_within_their_bounds() -> None:
    estimate = maximise(likelihoods, START, (1e-5, 0.015))
    assert estimate.fast_std == pytest.approx([0.015, 0.01], rel=0.03)


def test_disturbances_stay_if_no_likelihood_is_finite() -> None:
    estimate = maximise(lambda models: np.full((len(models), 2), np.nan), START, (1e-5, 1.0))
    assert estimate.logarithms == pytest.approx(START.logarithms)
    assert estimate.curvature is None


def test_logarithms_contain_all_parameters_of_the_disturbances() -> None:
    again = START.with_logarithms(MAXIMUM.logarithms)
    assert again.gains[0].std == pytest.approx(0.05, rel=1e-12)
    assert again.variance == pytest.approx(MAXIMUM.variance, rel=1e-12)
    assert again.autocorrelation(0.01) == pytest.approx(MAXIMUM.autocorrelation(0.01), rel=1e-12)
