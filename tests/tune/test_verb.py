"""``heli-host tune``: gains for any rig, written as parameters, and what they then fly like."""

from __future__ import annotations

import json
import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from heli_host.board.parameters import checked, read_parameter_set
from heli_host.ui.cli.entry import run
from heli_lab.control.tune.trial import FlightMetrics
from heli_lab.verbs.tune import _flight_lines
from heli_sim.rig import load_rig, write_rig

from tests.running.long import samples

pytestmark = pytest.mark.slow


def tuned(rig: str, folder: Path, *more: str) -> dict[str, Any]:
    files = [f"--{name}={folder / name}.{end}" for name, end in (("save-params", "toml"), ("json", "json"))]
    assert run(["tune", "--rig", rig, *files, *more]) == 0
    numbers: dict[str, Any] = json.loads((folder / "json.json").read_text())
    return numbers


@pytest.mark.parametrize(
    ("rig", "travel_rms_deg", "elevation_rms_deg"),
    # A constant torque pulls the course's rig round: it hovers with 7 degrees of tilt.
    [("quanser-course", 2.0, 0.4), ("makki2024-identified", 1.0, 0.4)][: samples(2, 1)],
)
def test_gains_for_a_rig_fly_hover_and_sines_on_it_within_stated_errors(
    rig: str, travel_rms_deg: float, elevation_rms_deg: float, tmp_path: Path
) -> None:
    numbers = tuned(rig, tmp_path)
    values = read_parameter_set(tmp_path / "save-params.toml").values
    assert values == numbers["parameters"]
    for name, value in values.items():
        checked(name, value)
    for flight in numbers["flights"]:
        assert flight["outcome"] == "completed"
        assert flight["travel_rms_deg"] <= travel_rms_deg
        assert flight["elevation_rms_deg"] <= elevation_rms_deg
    summary, log = tmp_path / "summary.json", tmp_path / "flight.mcap"
    flown = ["--sil", "--speed", "max", "--rig", rig, "--effect", "rotor_lag=0.12"]
    files = ["--params", str(tmp_path / "save-params.toml"), "--log", str(log), "--json", str(summary)]
    assert run(["fly", "hover", "sine", *flown, *files]) == 0
    errors = json.loads(summary.read_text())["rms_error_deg"]
    assert errors["travel"] <= 1.5 * travel_rms_deg
    assert errors["elevation"] <= elevation_rms_deg


def test_margins_of_every_loop_and_plant_and_excluded_effects_are_reported(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    effects = ("rotor_lag=0.1", "input_delay=0.01", "coulomb_friction.travel")
    numbers = tuned("makki2024", tmp_path, *(f"--effect={effect}" for effect in effects))
    assert [plant["lag_s"] for plant in numbers["plants"][:3]] == pytest.approx([0.075, 0.1, 0.125])
    assert {plant["delay_s"] for plant in numbers["plants"]} == {0.01}
    for plant in numbers["plants"]:
        assert set(plant["margins"]) == {"elevation", "pitch", "travel", "differential"}
        for margin in plant["margins"].values():
            assert margin["sensitivity"] <= 1.02 * numbers["sensitivity"]
            assert margin["delay_s"] > 0.03
    text = capsys.readouterr().out
    assert "lag 75 to 125 ms, delay 10 ms" in text
    assert "worst case" in text
    assert "heli-host fly hover --sil --rig makki2024 --params" in text
    assert "not in the design: coulomb_friction.travel" in text
    (flight,) = numbers["flights"]
    assert flight["overshoot_percent"] <= 10.0


def test_a_step_that_never_settles_has_no_settling_time() -> None:
    metrics = FlightMetrics("completed", math.inf, 11.0, math.inf, 0.44, 0.04, 12.0)
    (_, line) = _flight_lines([SimpleNamespace(label="lag 120 ms", metrics=metrics)])  # type: ignore[list-item]
    assert "take-off not settled; travel step: overshoot 11 %, not settled;" in line


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ({"M_w": 1.75}, "cannot hover at 0 degrees"),
        ({"M_w": 1.67}, "too little to move travel"),
        (
            {"thrust_gain": 0.03},
            "hovers at 14.7 V per motor, but its motors get at most 10.0 V; check its masses",
        ),
    ],
)
def test_a_rig_that_cannot_fly_gets_one_line(
    change: dict[str, float], why: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_rig(load_rig("makki2024").replace(**change), tmp_path / "bad.toml")
    assert (
        run(
            ["tune", "--rig", str(tmp_path / "bad.toml"), "--save-params", str(tmp_path / "save-params.toml")]
        )
        == 2
    )
    error = capsys.readouterr().err
    assert why in error
    assert error.count("\n") == 1
    assert not (tmp_path / "save-params.toml").exists()


@pytest.mark.parametrize(
    ("arguments", "why"),
    [
        (["--rig", "nowhere"], "nowhere"),
        (["--model", "mulitbody"], "did you mean multibody"),
        (["--effect", "rotorlag"], "did you mean rotor_lag"),
        (["--figure", "loops.gif"], "give a file that ends in"),
        (["--sensitivity", "1"], "1.6"),
    ],
)
def test_a_wrong_option_gets_one_line(
    arguments: list[str], why: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["tune", *arguments]) == 2
    error = capsys.readouterr().err
    assert why in error
    assert error.count("\n") == 1


def test_parameters_and_published_gains_are_not_flown_at_once(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "p.toml"
    file.write_text("[parameters]\nhover_V = 1.5\n")
    assert run(["fly", "hover", "--sil", "--gains", "paper", "--params", str(file)]) == 2
    assert "leave one of them out" in capsys.readouterr().err
    file.write_text("[parameters]\nhover_V = 150\n")
    assert run(["fly", "hover", "--sil", "--params", str(file)]) == 2
    assert "hover_V = 150 is out of range" in capsys.readouterr().err


def test_gains_whose_test_flights_failed_are_not_offered(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The arm floats without voltage, and no gains bring it down."""
    rig = load_rig("makki2024")
    write_rig(rig.replace(M_w=rig["M_w"].value + 0.05), tmp_path / "floats.toml")
    save_params = tmp_path / "gains.toml"
    code = run(["tune", "--rig", str(tmp_path / "floats.toml"), "--save-params", str(save_params)])
    printed = capsys.readouterr()
    assert code == 4
    assert "2 of 2 test flights with these gains failed" in printed.err
    assert "to fly with these gains" not in printed.out
    assert not save_params.exists()
