"""Real machines: what a lag, spinning rotors and the leading rotor explain of a flight that no fit saw."""

from __future__ import annotations

import pytest

from tests.measured.pairs import MEASURED, MODELS, PairFit, fit_pair
from tests.running.long import LONG, samples

HALF = 0.5


pytestmark = [
    pytest.mark.diagnosis,
    pytest.mark.skipif(not MEASURED.exists(), reason="skipped: no shared data"),
]


@pytest.fixture(scope="module")
def liveliest() -> list[PairFit]:
    """Baseline; lag, gyroscopic torque and edgewise flow. In `make long` from two starts each, and lag and
    gyroscopic torque alone between them.
    """
    return fit_pair("rendellc", [MODELS[0], *MODELS[2:3][: samples(1, 0)], MODELS[3]], once=not LONG)


def test_on_the_liveliest_pair_three_effects_halve_the_error_of_pitch_and_travel_ahead(
    liveliest: list[PairFit],
) -> None:
    all_three = liveliest[-1]
    for axis in ("pitch", "travel"):
        assert all_three.gain["2"][axis].ratio <= HALF
        error_deg = [pair.gain["2"][axis].after_deg for pair in liveliest]
        assert error_deg == sorted(error_deg, reverse=True)
    fit = all_three.fit
    for name in ("rotor_lag_s", "gyroscopic_torque_m_s", "edgewise_flow_s_per_m"):
        assert fit.params[name] > 10.0 * fit.std[name]
