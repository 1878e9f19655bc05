"""`heli-host identify`: flights in, a rig that flies out, with a page and numbers."""

import importlib
import json
import math
import re
from pathlib import Path

import numpy as np
import pytest
from heli_host.data.flight import Flight
from heli_host.data.log.reader import read_flight
from heli_host.data.log.table import write_csv
from heli_host.ui.cli.live import WorkBar
from heli_host.ui.cli.verb import spread
from heli_lab.fit import thresholds
from heli_lab.report.page import write_json
from heli_sim.rig import load_rig, write_rig

from tests.cli.terminal import Terminal

pytestmark = pytest.mark.slow
# The package exports a function of the same name.
solve = importlib.import_module("heli_lab.fit.shooting")

HIDDEN = {"thrust_gain": 0.63, "friction_travel": 0.055, "friction_pitch": 0.02}
SHORT = """
title = "A short excited flight"
[start]
settle_s = 1
[[segment]]
kind = "sine"
travel_amplitude_deg = 30
travel_period_s = 16
elevation_amplitude_deg = 7
elevation_period_s = 8
duration_s = {duration_s}
excite = {{ signal = "multisine", front_V = 0.3, back_V = 0.3, start_Hz = 0.1, stop_Hz = 4 }}
"""


_LOGS: dict[tuple[int, int], bytes] = {}
"""Logs of `fly_hidden`, by duration and seed: tests that fly the same flight share it."""


def fly_hidden(terminal: Terminal, folder: Path, name: str, duration_s: int, seed: int) -> None:
    """Fly the multibody model of a rig that is unlike the file `makki2024`."""
    write_rig(load_rig("makki2024").replace(**HIDDEN), folder / "hidden.toml")
    log = folder / f"{name}.mcap"
    if (duration_s, seed) not in _LOGS:
        (folder / "short.toml").write_text(SHORT.format(duration_s=duration_s))
        options = ("--speed", "max", "--model", "multibody", "--rig", "hidden.toml", "--seed", str(seed))
        flown = terminal("fly", "short.toml", "--sil", *options, "--log", log.name)
        assert flown.code == 0, flown
        _LOGS[duration_s, seed] = log.read_bytes()
    log.write_bytes(_LOGS[duration_s, seed])


def test_identified_rig_has_the_true_parameters_and_flies(terminal: Terminal, tmp_path: Path) -> None:
    fly_hidden(terminal, tmp_path, "a", 32, seed=1)
    fly_hidden(terminal, tmp_path, "b", 16, seed=2)
    write_csv(read_flight(tmp_path / "b.mcap"), tmp_path / "b.csv.gz")
    files = ("--save-rig", "new.toml", "--json", "new.json")
    ended = terminal("identify", "a.mcap", "--validate", "b.csv.gz", *files)
    assert ended.code == 0, ended
    assert "Only the encoders' quantisation remains on the validation flights" in ended.out
    assert "thrust_gain" in ended.out

    result = json.loads((tmp_path / "new.json").read_text())
    for name, value in HIDDEN.items():
        estimate = result["parameters"][name]
        assert estimate["value"] == pytest.approx(value, abs=4 * estimate["std"]), name
        assert set(estimate) >= {"value", "std", "prior", "unit"}
    assert set(result["normalised_residual"]) == {"train", "validation"}
    assert result["normalised_residual"]["validation"] <= 1.05
    assert set(result["free_run_rms_deg"]) == {"elevation", "pitch", "travel"}
    assert set(result["correlations"]) == set(result["parameters"])
    assert 30.0 < result["seconds_used"] < 40.0

    rig = load_rig(tmp_path / "new.toml")
    assert rig.model == "multibody"
    for name in HIDDEN:
        assert rig[name].value == pytest.approx(result["parameters"][name]["value"], rel=1e-6)
        assert "identified from a.mcap; before:" in rig[name].source
    assert terminal("rig", "check", "new.toml").code == 0
    hover = terminal("fly", "hover", "--sil", "--rig", "new.toml", "--speed", "max", "--log", "hover.mcap")
    assert hover.code == 0, hover


def test_page_is_self_contained_and_has_its_figures(terminal: Terminal, tmp_path: Path) -> None:
    fly_hidden(terminal, tmp_path, "a", 16, seed=1)
    result = terminal("identify", "a.mcap", "--free", *HIDDEN, "--report", "page/of/a")
    assert result.code == 0, result
    folder = tmp_path / "page/of/a"
    page = (folder / "index.html").read_text()
    sources = re.findall(r"(?:src|href)=\"([^\"]*)\"", page)
    assert sources and all(source.startswith("data:image/png;base64,") for source in sources)
    for name in ("train-1.png", "parameters.png", "correlations.png"):
        assert (folder / name).read_bytes().startswith(b"\x89PNG")
    for word in ("Measured against predicted", "What was found", "cannot identify", "left out", *HIDDEN):
        assert word in page
    assert json.loads((folder / "result.json").read_text())["parameters"].keys() == HIDDEN.keys()


def test_estimated_effect_is_in_the_rig_file_and_flies_with_it(terminal: Terminal, tmp_path: Path) -> None:
    (tmp_path / "a.toml").write_text(SHORT.format(duration_s=16))
    options = ("--sil", "--speed", "max", "--model", "multibody", "--effect", "rotor_lag=0.05")
    flown = terminal("fly", "a.toml", *options, "--log", "a.mcap")
    assert flown.code == 0, flown
    result = terminal("identify", "a.mcap", "--effect", "rotor_lag=0.1", "--save-rig", "new.toml")
    assert result.code == 0, result
    lag = load_rig(tmp_path / "new.toml").effects["rotor_lag"]["s"]
    assert lag.value == pytest.approx(0.05, abs=2 * lag.tolerance)
    hover = terminal("fly", "hover", "--sil", "--rig", "new.toml", "--speed", "max", "--log", "hover.mcap")
    assert hover.code == 0, hover


def test_fit_that_does_not_converge_says_so_in_every_output(
    terminal: Terminal, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fly_hidden(terminal, tmp_path, "a", 16, seed=1)
    files = ("--save-rig", "new.toml", "--report", "page", "--json", "new.json")
    monkeypatch.setattr(solve, "_ROUGH_STEPS", 1)
    monkeypatch.setattr(solve, "_FINE_STEPS", 1)
    monkeypatch.setattr(thresholds, "ROUNDS", 1)
    monkeypatch.setattr(thresholds, "FINE_ROUNDS", 1)
    result = terminal("identify", "a.mcap", *files)
    assert result.code == 1
    places = (result.out, *(Path(name).read_text() for name in ("new.toml", "page/index.html")))
    assert all("The fit did not converge" in " ".join(place.replace("#", "").split()) for place in places)
    assert json.loads(Path("new.json").read_text())["converged"] is False


def test_rig_and_used_flights_come_first(terminal: Terminal, tmp_path: Path) -> None:
    fly_hidden(terminal, tmp_path, "a", 16, seed=1)
    fly_hidden(terminal, tmp_path, "b", 16, seed=2)
    result = terminal("identify", "a.mcap", "--from", "12", "--validate", "b.mcap", "--free", "thrust_gain")
    assert result.code == 0, result
    rig, model, *more = result.out.splitlines()
    (flights,) = (line for line in more if line.startswith("flights: "))
    assert rig == "rig: makki2024 (the default of --rig)"
    assert model == "model: multibody"
    notes = [line for line in more if line.startswith("note: ")]
    assert notes == [
        f"note: {name} is a flight of rig hidden, and --rig is makki2024" for name in ("a.mcap", "b.mcap")
    ]
    # One time is for the flights to fit: the validation flight stays whole.
    used = re.fullmatch(
        r"flights: fitted a.mcap \((\d+) s used\); validated on b.mcap \((\d+) s used\)", flights
    )
    assert used and int(used[1]) < int(used[2]) - 5
    mine = terminal("identify", "a.mcap", "--rig", "hidden.toml", "--free", "thrust_gain")
    assert mine.out.startswith("rig: hidden.toml (makki2024)\n") and "note: " not in mine.out


@pytest.mark.parametrize(
    ("typed", "meant"),
    [
        ("a b --validate c d --rig r e", "a b --validate c --validate d --rig r e"),
        ("--validate c --validate d", "--validate c --validate d"),
        ("a --validate c -1 --json j", "a --validate c --validate -1 --json j"),
        ("a --validate -- b", "a --validate -- b"),
    ],
)
def test_option_collects_all_words_up_to_the_next_option(typed: str, meant: str) -> None:
    assert spread(typed.split(), frozenset({"--validate"})) == meant.split()


def test_a_second_flight_to_validate_on_is_not_fitted(terminal: Terminal, tmp_path: Path) -> None:
    random = np.random.default_rng(1)
    for name in "abc":
        t_s = np.linspace(0.0, 5.998, 3000)
        wave = np.sin(2 * np.pi * t_s / 3.0) + 0.01 * random.standard_normal()
        volts = 1.7 + 0.2 * wave, 1.7 - 0.1 * wave
        write_csv(Flight(t_s, *volts, 0.1 * wave, 0.2 * wave, 0.5 * wave), tmp_path / f"{name}.csv")
    result = terminal(
        *("identify", "a.csv", "--free", "thrust_gain", "--validate", "b.csv", "c.csv", "--json", "-")
    )
    assert result.code == 0, result
    flights = json.loads(result.out)["flights"]
    assert "thrust_gain" in result.err
    assert [(flight["flight"], flight["role"]) for flight in flights] == [
        *(("a.csv", "train"), ("b.csv", "validation"), ("c.csv", "validation"))
    ]


def test_json_has_null_for_what_is_not_finite(tmp_path: Path) -> None:
    write_json(tmp_path / "a.json", {"gain_up": math.inf, "rows": ((1.0, math.nan),), 3: "inf"})
    assert json.loads((tmp_path / "a.json").read_text()) == {
        "gain_up": None,
        "rows": [[1.0, None]],
        "3": "inf",
    }


def test_progress_lines_show_the_step_and_the_time_left(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    now_s = iter((0.0, 5.0, 10.0, 20.0))
    monkeypatch.setattr("heli_host.ui.cli.live.time.monotonic", lambda: next(now_s))
    with WorkBar(is_terminal=False) as bar:
        bar.show("reading", 0.0)
        bar.show("compiling the model", 0.1)
        bar.show("every sample", 0.5)
    assert capsys.readouterr().out.splitlines() == [
        "reading: 0 %",
        "compiling the model: 10 %, about 90 s left",
        "every sample: 50 %, about 20 s left",
    ]


def test_the_bar_of_a_terminal_is_gone_afterwards(capsys: pytest.CaptureFixture[str]) -> None:
    with WorkBar(is_terminal=True) as bar:
        bar.show("every sample", 0.5)
    assert "\n" not in capsys.readouterr().out.strip()
