"""Search for the most likely disturbances, tested on quadratic likelihoods whose maximum is known.

The disturbance of an output changes the likelihood of that output only. A disturbance of a gain changes the
likelihoods of all outputs, so the search must maximise their sum.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from heli_host.data.arrays import Floats
from heli_lab.fit.estimator import maximise
from heli_lab.fit.grey_box import DisturbanceModel, GainDisturbance

START = DisturbanceModel.start((0.01, 0.02), (0.001, 0.002)).with_gains(1)
MAXIMUM = DisturbanceModel(
    np.array([0.02, 0.01]),
    np.array([0.2, 1.0]),
    np.array([0.003, 0.001]),
    np.array([1.0, 0.3]),
    (GainDisturbance(0.05, 2.0),),
)


def likelihoods(models: Sequence[DisturbanceModel]) -> Floats:
    """Return quadratic log-likelihoods of two outputs, shape (models, 2).

    The likelihood of an output is largest at the `MAXIMUM` of its own four parameters. The two parameters of
    the gain change both likelihoods by opposite amounts; only the sum is largest at the `MAXIMUM`.
    """
    values = []
    for model in models:
        distances = model.logarithms - MAXIMUM.logarithms
        output_distances, gain_distances = distances[:8].reshape(2, 4), distances[8:]
        of_outputs = -20.0 * (output_distances**2).sum(axis=1)
        of_gain = np.array([-30.0, 10.0]) * (gain_distances**2).sum()
        opposite = gain_distances[0] * np.array([3.0, -3.0])
        values.append(of_outputs + of_gain + opposite)
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
    restored = START.with_logarithms(MAXIMUM.logarithms)
    assert restored.gains[0].std == pytest.approx(0.05, rel=1e-12)
    assert restored.variance == pytest.approx(MAXIMUM.variance, rel=1e-12)
    assert restored.autocorrelation(0.01) == pytest.approx(MAXIMUM.autocorrelation(0.01), rel=1e-12)
