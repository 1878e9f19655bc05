"""Spline terms: their basis, and the channels and quantities that are tried."""

from __future__ import annotations

import numpy as np
from heli_lab.explain.candidates import KNOTS, bspline_basis, channel_quantity_pairs, knot_span


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
