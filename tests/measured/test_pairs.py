"""Real machines: what a lag, spinning rotors and the leading rotor explain of a flight that no fit saw."""

from __future__ import annotations

import pytest

from tests.measured.pairs import MEASURED, told

HALF = 0.5


@pytest.mark.skipif(not MEASURED.exists(), reason="skipped: no shared data")
def test_on_the_liveliest_pair_three_effects_halve_the_error_of_every_axis_ahead() -> None:
    baseline, lag, gyroscopic, all_three = told("rendellc")
    assert all(of.ratio <= HALF for of in all_three.gain.values())
    assert all(of.interval95[1] < 0.7 for of in all_three.gain.values())
    pitch_deg = [one.gain["pitch"].after_deg for one in (baseline, lag, gyroscopic, all_three)]
    assert pitch_deg == sorted(pitch_deg, reverse=True)
    fit = all_three.hypothesis.fit
    for name in ("rotor_lag_s", "gyroscopic_torque_m_s", "edgewise_flow_s_per_m"):
        assert fit.values[name] > 10.0 * fit.std[name]
