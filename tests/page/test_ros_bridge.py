"""The ROS 2 bridge of the documents publishes each tick of a flight once, as the types of ROS 2 accept it."""

from __future__ import annotations

import itertools
import re
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest

pytest.importorskip("starlette", reason="skipped: the extra 'page' is not installed")

from tests.page.page_server import page_of_a_simulated_board
from tests.running.order import REAL_TIME

pytestmark = [pytest.mark.slow, pytest.mark.xdist_group(REAL_TIME)]

GUIDE = Path(__file__).parents[2] / "docs" / "how-to" / "your-program.md"
LOOPS = 20
"""Loops after which the node ends. The first one publishes what the dashboard has; the others add to it."""


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
