"""Programs join a page: any value gets an answer or an error of one line; the ROS 2 bridge publishes."""

import itertools
import math
import re
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import heli_host
import pytest
from heli_host.errors import HeliError, LinkError, ParameterError, PortError
from heli_host.ui.page.client import PageClient, PageError
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.page.hostile_requests import ARGUMENTS, ODD
from tests.page.page_server import Served, SocketPage, log_lines, page_of_a_simulated_board, traces
from tests.running.long import samples
from tests.running.order import REAL_TIME

pytestmark = [pytest.mark.slow, pytest.mark.xdist_group(REAL_TIME)]

VALUES = st.one_of(st.sampled_from(ODD), st.text(max_size=50), st.floats(), st.integers())
NUMBERS = st.one_of(st.floats(), st.integers(), st.sampled_from([10**400, -(10**400), True]))
SHORT_S = st.sampled_from([0.0, -1.0, math.nan, -math.inf, 0.01])
CALLS: dict[str, st.SearchStrategy[dict[str, Any]]] = {
    "set": st.fixed_dictionaries({"name": st.text(max_size=50) | st.just("travel_kp"), "value": NUMBERS}),
    "setpoint": st.fixed_dictionaries(
        {"elevation_deg": NUMBERS | st.none(), "travel_deg": NUMBERS | st.none()}
    ),
    "mark": st.fixed_dictionaries({"text": st.text(max_size=5000)}),
    "signal": st.fixed_dictionaries({"name": st.text(max_size=100), "value": NUMBERS}),
    "samples": st.fixed_dictionaries({"last_s": NUMBERS}),
    "ask_control": st.fixed_dictionaries({"timeout_s": SHORT_S}),
    "wait_for_state": st.fixed_dictionaries({"timeout_s": SHORT_S}),
}
GUIDE = Path(__file__).parents[2] / "docs" / "how-to" / "your-program.md"
LOOPS = 20
"""Loops after which the node ends. The first one publishes what the dashboard has; the others add to it."""


@pytest.fixture(scope="module")
def served(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    with (
        page_of_a_simulated_board(tmp_path_factory.mktemp("join")) as page_server,
        SocketPage(page_server.address, "pilot") as pilot,
    ):
        # Otherwise the program would get control as soon as it asks.
        assert pilot.flies
        yield page_server


@pytest.fixture(scope="module")
def program(served: Served) -> Iterator[PageClient]:
    with heli_host.join(served.address.program) as client:
        yield client


def is_one_line(error: HeliError) -> bool:
    return bool(str(error)) and "\n" not in str(error) and len(str(error)) < 1000


@settings(max_examples=samples(1000, 60), deadline=None)
@given(call=st.sampled_from(sorted(CALLS)).flatmap(lambda name: st.tuples(st.just(name), CALLS[name])))
def test_every_call_with_any_value_is_done_or_an_error_of_one_line(
    program: PageClient, call: tuple[str, dict[str, Any]]
) -> None:
    name, arguments = call
    with log_lines() as lines:
        try:
            getattr(program, name)(**arguments)
        except HeliError as error:
            assert is_one_line(error)
    assert not traces(lines)
    assert program.ask("mark", text="still here") is not None


@settings(max_examples=samples(1000, 60), deadline=None)
@given(
    name=st.sampled_from([action for action in ARGUMENTS if action not in ("ask", "take_off")])
    | st.text(max_size=20),
    more=st.dictionaries(st.sampled_from(["id", "do", "name", "value", "text", "on"]), VALUES, max_size=4),
)
def test_every_request_with_any_argument_is_answered(
    program: PageClient, name: str, more: dict[str, Any]
) -> None:
    try:
        program.ask(name, **more)
    except LinkError as error:
        raise AssertionError(f"{name} {more} was not answered") from error
    except HeliError as error:
        assert is_one_line(error)


@settings(max_examples=samples(2000, 100), deadline=None)
@given(
    st.one_of(
        st.text(max_size=80),
        st.text(max_size=80).map("page://{}/?token=x".format),
        st.sampled_from(
            ["[", "[::1", "a:b", "a:99999999", "127.0.0.1:0", "\ud800", "a" * 70 + ".b", "\0", ""]
        ).map("page://{}/?token=x".format),
    )
)
def test_an_address_that_is_none_is_an_error_of_one_line(address: str) -> None:
    with pytest.raises((PortError, LinkError)) as raised:
        heli_host.join(address)
    assert is_one_line(raised.value)


def test_a_request_that_json_cannot_hold_is_an_error_of_one_line(program: PageClient) -> None:
    for value in (object(), {1, 2}, b"x", 1j):
        with pytest.raises(PageError, match="JSON cannot hold the request"):
            program.ask("mark", text=value)


def test_a_request_that_the_server_would_not_read_is_not_waited_for(program: PageClient) -> None:
    with pytest.raises(PageError, match=r"a request of \d+ characters is too long; send at most 4096"):
        program.mark("x" * 5000)


def test_a_number_that_is_not_finite_is_refused_before_samples_are_cut(program: PageClient) -> None:
    program.wait_for_state(program.state, timeout_s=math.inf)
    with pytest.raises(ParameterError, match="last_s is nan, not a finite number"):
        program.samples(last_s=math.nan)
    assert len(program.samples(last_s=-1.0)) == 0


@dataclass
class Time:
    """A stamp, with the ranges that ROS 2 checks."""

    sec: int
    nanosec: int

    def __post_init__(self) -> None:
        assert type(self.sec) is int and type(self.nanosec) is int
        assert 0 <= self.nanosec < 1_000_000_000


@dataclass
class JointState:
    """Joint angles, with the types that ROS 2 checks."""

    name: list[str]
    position: list[float]
    header: SimpleNamespace = field(default_factory=SimpleNamespace)

    def __post_init__(self) -> None:
        assert type(self.name) is list and type(self.position) is list
        assert all(type(angle) is float for angle in self.position)


def stub_ros(monkeypatch: pytest.MonkeyPatch) -> list[JointState]:
    """Put modules in the place of ROS 2, and return the list of what is published."""
    published: list[JointState] = []
    spins: list[float] = []

    def create_publisher(kind: type, topic: str, _: int) -> SimpleNamespace:
        assert (kind, topic) == (JointState, "joint_states")
        return SimpleNamespace(publish=published.append)

    def spin_once(node: object, timeout_sec: float) -> None:
        spins.append(timeout_sec)
        time.sleep(timeout_sec)

    modules: dict[str, dict[str, Any]] = {
        "rclpy": {
            "init": lambda: None,
            "ok": lambda: len(spins) < LOOPS,
            "create_node": lambda name: SimpleNamespace(create_publisher=create_publisher),
            "spin_once": spin_once,
        },
        "builtin_interfaces": {},
        "builtin_interfaces.msg": {"Time": Time},
        "sensor_msgs": {},
        "sensor_msgs.msg": {"JointState": JointState},
    }
    for name, content in modules.items():
        module = ModuleType(name)
        module.__dict__.update(content)
        monkeypatch.setitem(sys.modules, name, module)
    return published


def test_the_bridge_publishes_each_tick_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    published = stub_ros(monkeypatch)
    (script,) = re.findall(r"```python\n(import sys\n.*?rclpy.*?)```", GUIDE.read_text(), re.DOTALL)
    with page_of_a_simulated_board(tmp_path) as served:
        monkeypatch.setattr(sys, "argv", ["ros2_bridge.py", served.address.program])
        exec(compile(script, "ros2_bridge.py", "exec"), {"__name__": "__main__"})
    assert len(published) > LOOPS
    ticks = [
        message.header.stamp.sec * 1000 + message.header.stamp.nanosec // 1_000_000 for message in published
    ]
    assert all(later > earlier for earlier, later in itertools.pairwise(ticks))
    assert {tuple(message.name) for message in published} == {("elevation", "pitch", "travel")}
    # The arm rests on its table.
    assert all(-0.6 < message.position[0] < -0.3 for message in published)
