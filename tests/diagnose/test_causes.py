"""What is hidden is found, nothing is found in nothing, and what is off the list is said to be so."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from heli_lab.diagnose import Diagnosis, diagnose, summary, to_json
from heli_lab.diagnose.error_reduction import judgement
from heli_lab.diagnose.report import write_report
from heli_sim.model import MultibodyModel
from heli_sim.model.effects import effects_of
from heli_sim.rig import load_rig, write_rig

from tests.diagnose.hidden import flights
from tests.diagnose.schema import conforms

pytestmark = pytest.mark.diagnosis


@cache
def diagnosed(*effects: str, off_list: bool = False) -> Diagnosis:
    """Diagnose a flight with something hidden in it."""
    fit, held_out = flights(*effects, off_list=off_list)
    return diagnose(MultibodyModel(), load_rig("makki2024"), [fit], [held_out], labels=["fit", "held out"])


def test_answer_has_the_keys_and_units_that_were_promised_whatever_the_verdict() -> None:
    for found in (diagnosed(), diagnosed("rotor_lag=0.06"), diagnosed(off_list=True)):
        conforms(to_json(found))


def test_seed_settles_the_intervals() -> None:
    found = diagnosed("rotor_lag=0.06")
    runs = found.judgement.before, found.judgement.after
    drawn = [judgement(*runs, seed).horizons["2"]["pitch"] for seed in (1, 1, 2)]
    assert drawn[0] == drawn[1]
    assert drawn[0].interval95 != drawn[2].interval95
    assert drawn[0].ratio == drawn[2].ratio


def test_work_that_runs_out_is_said_where_the_verdict_is() -> None:
    fit, held_out = flights("rotor_lag=0.06")
    found = diagnose(MultibodyModel(), load_rig("makki2024"), [fit], [held_out], refits=0)
    numbers = to_json(found)
    conforms(numbers)
    assert numbers["complete"] is False
    assert numbers["causes"] == []
    assert "The work allowed ran out before everything was tried" in summary(found)
    assert any("--budget" in caution for caution in numbers["cautions"])


def test_nothing_hidden_is_explained_without_a_cause() -> None:
    found = diagnosed()
    numbers = to_json(found)
    assert numbers["verdict"] == "explained"
    assert numbers["causes"] == []
    assert numbers["unexplained"] is None
    assert numbers["residual"]["normalised"]["held_out_after"] < 1.05


@pytest.mark.parametrize(
    ("effect", "name", "truth"),
    [
        ("rotor_lag=0.06", "rotor_lag_s", 0.06),
        ("cable_spring.travel=0.06", "cable_spring_travel_Nm_per_rad", 0.06),
    ],
)
def test_hidden_effect_is_named_measured_and_halves_the_error(effect: str, name: str, truth: float) -> None:
    numbers = to_json(diagnosed(effect))
    assert numbers["verdict"] == "cause_found"
    first, *others = numbers["causes"]
    assert first["effect"] == effect.partition("=")[0]
    assert others == []
    found = first["parameters"][name]
    assert abs(found["value"] - truth) < 3.0 * found["std"]
    assert first["confidence"] > 0.9
    best = min(numbers["gain"]["axis"].values(), key=lambda one: one["ratio"])
    assert best["ratio"] < best["interval95"][1] < 0.5


def test_effect_that_no_catalogue_has_is_unexplained_and_said_to_go_with_elevation() -> None:
    numbers = to_json(diagnosed(off_list=True))
    assert numbers["verdict"] == "unexplained"
    assert numbers["causes"] == []
    assert numbers["unexplained"]["axis"] == "pitch"
    assert numbers["unexplained"]["correlates_with"][0] == "torque.pitch on elevation"
    assert numbers["unexplained"]["share_of_variance"] > 0.9
    assert "[[segment]]" in numbers["next_flight"]["plan"]


def test_curve_in_the_place_of_an_unknown_cause_is_the_cause_and_in_no_rig(tmp_path: Path) -> None:
    found = diagnosed(off_list=True)
    (curve,) = found.curves
    # 0.05 N m a radian was hidden, in mN m against degrees, and a constant belongs to the trim.
    slope = np.polyfit(curve.place, curve.value, 1)[0]
    assert slope == pytest.approx(50.0 * np.pi / 180.0, rel=0.1)
    assert found.spline_gains["pitch"].ratio < 0.2
    assert found.gains["pitch"].ratio == pytest.approx(1.0)
    assert found.rig("extended").effects == {}
    page = write_report(found, tmp_path).read_text(encoding="utf-8")
    assert "torque.pitch on elevation, seen from" in page
    assert (tmp_path / "curves.png").exists()


def test_extended_rig_is_read_back_with_the_cause_and_its_size(tmp_path: Path) -> None:
    found = diagnosed("rotor_lag=0.06")
    write_rig(found.rig("extended"), tmp_path / "extended.toml")
    (effect,) = effects_of(load_rig(tmp_path / "extended.toml"))
    assert effect.name == "rotor_lag"
    assert effect.values["rotor_lag_s"] == pytest.approx(0.06, abs=0.003)


def test_report_needs_nothing_else_and_says_the_cause_with_its_number(tmp_path: Path) -> None:
    page = write_report(diagnosed("rotor_lag=0.06"), tmp_path).read_text(encoding="utf-8")
    assert "The rotors&#x27; thrust lags their voltage by 0.0" in page
    assert "http" not in page.replace("http-equiv", "")
    assert {"flight.png", "torque.png", "ranking.png", "windows.png", "size.png", "index.html"} <= {
        path.name for path in tmp_path.iterdir()
    }
