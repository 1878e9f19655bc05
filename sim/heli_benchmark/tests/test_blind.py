"""A fast share of the blind cases: something is hidden in MuJoCo's flights, and the diagnosis has to find it.

`make test` takes the first with something hidden, on flights half as long and at 500 Hz; `make long` takes
all of these cases as they are. All cases: `make blind`.
"""

import json
import subprocess
import sys
import tempfile
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from heli_host.data.log.reader import read_flight
from heli_host.data.log.table import write_csv

import heli_benchmark
from heli_benchmark.cases.clean import TRAIN_S, VALIDATE_S, Stream, clean_cases
from heli_benchmark.flights import flown, plan
from tests.identify import made
from tests.running.kept import KEPT
from tests.running.long import LONG, samples

pytestmark = pytest.mark.diagnosis

MADE_BY = (*sorted(Path(heli_benchmark.__file__).parent.rglob("*.py")), Path(made.__file__))
DURATIONS_S = (TRAIN_S, VALIDATE_S) if LONG else (38.0, 34.0)
EVERY_ROW = samples(1, 2)
NOTHING = ("nothing-6",)
ONE = {"rotor_lag-small": "rotor_lag", "cable_spring.travel-large": "cable_spring.travel"}
OFF_LIST = ("off-bumpy_pitch-large",)
CASES = {case.name: case for case in clean_cases()}


def apart(*names: str) -> list[Any]:
    """Cases for workers of their own: nothing is shared between them."""
    return [pytest.param(name, marks=pytest.mark.xdist_group(f"blind-{name}")) for name in names]


@cache
def answer(name: str) -> dict[str, Any]:
    """Diagnosis of a case as JSON."""
    case = CASES[name]

    def make() -> dict[str, Any]:
        with tempfile.TemporaryDirectory() as folder:
            for path in case.flights(Path(folder), DURATIONS_S):
                write_csv(made.thinned(read_flight(path), EVERY_ROW), path)
            # As `make blind` does, on flights that are there already.
            command = [
                sys.executable,
                "-m",
                "heli_benchmark",
                "--keep",
                "--processes",
                "1",
                "--folder",
                folder,
            ]
            ended = subprocess.run(
                [*command, "--json", f"{folder}/blind.json", name],
                capture_output=True,
                text=True,
                check=False,
            )
            assert ended.returncode == 0 and "goals, 1 cases" in ended.stdout, ended.stdout + ended.stderr
            answered = json.loads((Path(folder) / name / "diagnosis.json").read_text())["what"]
        assert not answered["failure"]
        result: dict[str, Any] = answered["result"]
        return result

    print(f"{name}: seed {case.seed}")
    return KEPT(f"blind {case!r} {DURATIONS_S} {EVERY_ROW}", make, made_by=MADE_BY)


def surely(result: dict[str, Any]) -> set[str]:
    """Causes given with a confidence of at least 0.9."""
    return {cause["effect"] for cause in result["causes"] if cause["confidence"] >= 0.9}


@pytest.mark.skipif(not LONG, reason="tests/diagnose hides nothing, too; this one runs in make long")
@pytest.mark.parametrize("name", apart(*NOTHING))
def test_a_rig_with_other_numbers_and_nothing_hidden_raises_no_alarm(name: str) -> None:
    result = answer(name)
    assert (result["verdict"], result["causes"]) == ("explained", [])


def test_a_flight_whose_arm_never_reaches_the_table_is_complete() -> None:
    case = CASES["cable_spring.travel-large"]
    flight = flown(
        case.rig(), case.hidden(), plan(str(case.seed), 32.0, Stream.FLOWN_PLAN.rng(case.seed, 0)), case.seed
    )
    assert any("landing" in event.text and event.name == "state" for event in flight.events)
    assert np.degrees(flight.elevation_rad[-1]) > -25.0


@pytest.mark.parametrize("name", apart(*list(ONE)[: samples(2, 1)]))
def test_the_hidden_effect_is_named_for_sure_and_with_its_size(name: str) -> None:
    result = answer(name)
    assert [cause["effect"] for cause in result["causes"]] == [ONE[name]]
    assert surely(result) == {ONE[name]}
    size = next(iter(result["causes"][0]["parameters"].values()))
    assert size["value"] == pytest.approx(CASES[name].truth()[ONE[name]]["size"], abs=3.0 * size["std"])
    assert result["residual"]["normalised"]["held_out_after"] < 1.05


@pytest.mark.skipif(not LONG, reason="tests/diagnose hides one too; this one runs in make long")
@pytest.mark.parametrize("name", apart(*OFF_LIST))
def test_what_is_on_no_list_is_called_unexplained_and_nothing_else_for_sure(name: str) -> None:
    result = answer(name)
    assert result["verdict"] == "unexplained"
    assert surely(result) == set()
