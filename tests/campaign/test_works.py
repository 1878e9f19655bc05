"""Flights, fits and gain checks as cases: equal settings give equal rows, other rigs give others."""

from __future__ import annotations

from typing import Any

import pytest
from heli_lab.apps.campaign import works
from heli_sim.rig import load_rig

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
