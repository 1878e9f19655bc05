"""Every text argument of the public interface that has a set of values is checked before anything flies."""

import importlib
import inspect
import re
import typing
from collections.abc import Callable, Iterator
from pathlib import Path

import heli_host
import numpy as np
import pytest
from heli_host.board.heli import Heli
from heli_host.board.law_flight import run_controller
from heli_host.board.samples import Sample
from heli_host.data.flight import Flight
from heli_host.data.response import steps
from heli_host.declaration import State
from heli_host.errors import HeliError
from heli_host.fly.plan import Plan, load_plan
from heli_host.fly.runner import fly
from heli_lab.control.law import Law, from_gain

pytestmark = pytest.mark.medium

API = Path(__file__).resolve().parents[2] / "docs" / "reference" / "api" / "heli_host.md"
WRONG: typing.Any = "Land"
"""A typing error in one of the arguments, which are written in small letters."""


def hold_still(_: Sample) -> tuple[float, float]:
    raise AssertionError("the law was called")


def still_flight() -> Flight:
    t_s, nothing = np.linspace(0.0, 0.09, 10), np.zeros(10)
    return Flight(
        t_s=t_s, front_V=nothing, back_V=nothing, elevation_rad=nothing, pitch_rad=nothing, travel_rad=nothing
    )


def law() -> Law:
    return from_gain([[0.0] * 6] * 2, hover_V=6.0)


CHECKED: dict[str, Callable[[Heli], object]] = {
    "Heli.run_controller after": lambda heli: heli.run_controller(hold_still, duration_s=1.0, after=WRONG),
    "run_controller after": lambda heli: run_controller(heli, hold_still, duration_s=1.0, after=WRONG),
    "Heli.fly_law after": lambda heli: heli.fly_law(law(), duration_s=1.0, after=WRONG),
    "Heli.set_law_parameter name": lambda heli: heli.set_law_parameter(law(), WRONG, 1.0),
    "Heli.excite kind": lambda heli: heli.excite(WRONG),
    "Heli.fly plans": lambda heli: heli.fly(WRONG),
    "fly plans": lambda heli: fly(heli, [WRONG]),
    "load_plan name": lambda _: load_plan(WRONG),
    "Plan.parse text": lambda _: Plan.parse(f'[[segment]]\nkind = "{WRONG}"\n', "a.toml"),
    "Plan.of_tables values": lambda _: Plan.of_tables({"axes": [WRONG]}, "", "a.toml", "a"),
    "Plan.__init__ axes": lambda heli: fly(
        heli, Plan.parse(f'axes = ["elevation", "pitch", "{WRONG}"]', "a.toml")
    ),
    "connect url": lambda _: heli_host.connect(f"sil://?board={WRONG}"),
    "steps axis": lambda _: steps(still_flight(), WRONG),
}
"""A call with a wrong text for each argument that has a set of values."""
FREE = re.compile(
    r"""
    (HeliError|WrongDevice|LinkVersionMismatch|Sample|Samples|StepMetrics|Step|Response|Flight|Progress|FlightSummary)\.
    | \ (path|log|log_path|json_path|figure_path|address|option|cause|remedy|label|comment)$
    | \ (source|title|text|note|outcome)$
    | \ (rig_name|board_name|seal_digest|setup|end_when|parameters|phase|name|choices|axes|rig|extra)$
    """,
    re.VERBOSE,
)
"""Arguments that hold any text, such as paths and messages, or values that the program made itself."""


def text_arguments() -> Iterator[str]:
    """The arguments with a text of the functions and classes that the documents publish."""
    for module_name in re.findall(r"automodule:: (\S+)", API.read_text(encoding="utf-8")):
        module = importlib.import_module(module_name)
        names = getattr(module, "__all__", None) or [
            name for name, item in vars(module).items() if getattr(item, "__module__", "") == module_name
        ]
        for name in (name for name in names if not name.startswith("_")):
            item = getattr(module, name)
            members = (
                [
                    function
                    for key, function in inspect.getmembers(item, callable)
                    if key[0] != "_" or key == "__init__"
                ]
                if inspect.isclass(item)
                else [item]
            )
            for function in members:
                is_ours = "heli_host" in str(getattr(function, "__module__", ""))
                if not inspect.isroutine(function) or not is_ours:
                    continue
                for argument, annotation in getattr(function, "__annotations__", {}).items():
                    if argument != "return" and re.search(
                        r"\bstr\b|Literal|AfterLaw|PlanLike|AnyPlan|Excitation", str(annotation)
                    ):
                        yield f"{function.__qualname__} {argument}"


def test_every_text_argument_is_checked_or_free() -> None:
    unclassified = {name for name in text_arguments() if name not in CHECKED and not FREE.search(name)}
    assert not unclassified, "add a wrong value to CHECKED, or the name to FREE"


def test_the_table_names_arguments_that_exist() -> None:
    assert set(CHECKED) <= set(text_arguments())


@pytest.mark.parametrize("argument", CHECKED)
def test_a_wrong_text_is_refused_and_nothing_flies(argument: str) -> None:
    with heli_host.connect("sil://?seed=2") as heli:
        states: set[int] = set()
        heli.on_ticks(lambda samples: states.update(samples.state.tolist()))
        with pytest.raises(HeliError, match=WRONG):
            CHECKED[argument](heli)
        heli.wait(0.2)
    assert states == {State.IDLE}


def test_a_wrong_text_in_the_air_calls_no_law_and_the_arm_lands() -> None:
    with (
        pytest.raises(HeliError, match="'hold' or 'land' or 'stop'"),
        heli_host.connect("sil://?seed=2") as heli,
    ):
        states: list[int] = []
        heli.on_ticks(lambda samples: states.extend(samples.state.tolist()))
        heli.take_off()
        heli.run_controller(hold_still, duration_s=1.0, after=WRONG)
    assert State.STREAMED not in states
    assert states[-1] == State.IDLE
    assert State.LANDING in states


@pytest.mark.parametrize("value", ["3", None, float("nan"), float("inf"), 1 + 1j])
def test_a_setpoint_that_is_no_number_is_refused_before_it_is_sent(value: object) -> None:
    with heli_host.connect("sil://?seed=2") as heli:
        for call in (
            lambda: heli.take_off(elevation_deg=value),  # type: ignore[arg-type]
            lambda: heli.voltages(front_V=value, back_V=1.0),  # type: ignore[arg-type]
            lambda: heli.setpoint(elevation_deg=1.0, lead_s=value),  # type: ignore[arg-type]
        ):
            with pytest.raises(HeliError):
                call()
        assert heli.state is State.IDLE
