"""A live viewer gets every tick of the board by Foxglove's protocol, and can do nothing but read."""

import json
import os
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import heli_host
import numpy as np
import pytest
from heli_host.board.heli import Heli
from heli_host.data.log.schema import EVENT_TOPIC, TICK_TOPIC, parse_layout, raw_ticks
from heli_host.declaration import CHANNELS
from heli_host.errors import PortError
from heli_host.ui import foxglove_feed as feeds
from heli_host.ui.foxglove_server import is_permitted

from tests.cli.terminal import Terminal
from tests.page.page_server import SHORT_PLAN

pytest.importorskip("foxglove", reason="skipped: no foxglove-sdk")
pytest.importorskip("websockets.sync.client", reason="skipped: no websockets")

from websockets import Origin, Subprotocol
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from tests.link.foxglove_viewer import PATIENCE_S, Viewer

PROTOCOL = Subprotocol("foxglove.sdk.v1")

pytestmark = pytest.mark.medium


@pytest.fixture
def heli() -> Iterator[Heli]:
    with heli_host.connect("sil://?speed=max") as board:
        yield board


def until_watched(heli: Heli, viewer: Viewer) -> None:
    """Let the board run until the subscription holds, and a tick has come."""
    end_s = time.monotonic() + PATIENCE_S
    while not viewer.has_message():
        assert time.monotonic() < end_s, "no tick comes"
        heli.wait(0.02)


@contextmanager
def feed_and_viewer(heli: Heli) -> Iterator[Viewer]:
    with feeds.foxglove_feed(heli, 0) as feed:
        assert feed is not None
        with Viewer.of(feed.address) as viewer:
            yield viewer


def test_a_viewer_gets_every_tick_as_the_board_sent_it(heli: Heli) -> None:
    sent_values: list[tuple[np.ndarray[Any, Any], np.ndarray[Any, Any]]] = []
    with feed_and_viewer(heli) as viewer:
        assert viewer.channels[TICK_TOPIC]["encoding"] == "cdr"
        viewer.subscribe(TICK_TOPIC)
        heli.session.subscribe_ticks(lambda ticks: sent_values.append((ticks.tick.copy(), ticks.raw.copy())))
        until_watched(heli, viewer)
        heli.wait(1.5)
        tick, raw = (np.concatenate(parts) for parts in zip(*sent_values, strict=True))
        got = viewer.messages(1)
        first = int(
            np.frombuffer(got[0].body[4:], parse_layout(viewer.channels[TICK_TOPIC]["schema"]).dtype)["tick"][
                0
            ]
        )
        tick, raw = tick[tick >= first], raw[tick >= first]
        got += viewer.messages(tick.size - 1)
    layout = parse_layout(viewer.channels[TICK_TOPIC]["schema"])
    records = np.frombuffer(b"".join(message.body[4:] for message in got), layout.dtype)
    np.testing.assert_array_equal(records["tick"], tick)
    assert np.diff(records["tick"]).tolist() == [1] * (tick.size - 1) and tick.size >= 1000
    np.testing.assert_array_equal(raw_ticks(records), raw)
    assert np.diff([message.time_ns for message in got]).tolist() == [1_000_000] * (tick.size - 1)
    assert {spec.field for spec in CHANNELS} <= set(records.dtype.names or ())


def test_a_viewer_gets_events_and_can_do_nothing_but_read(heli: Heli) -> None:
    with feed_and_viewer(heli) as viewer:
        assert viewer.info["op"] == "serverInfo" and viewer.info["capabilities"] == []
        viewer.subscribe(EVENT_TOPIC)
        viewer.socket.send(
            json.dumps({"op": "setParameters", "parameters": [{"name": "travel_kp", "value": 9}]})
        )
        end_s = time.monotonic() + PATIENCE_S
        # The subscription holds once the server has read it.
        while not viewer.has_message():
            assert time.monotonic() < end_s, "no event comes"
            heli.zero()
            heli.wait(0.1)
        (message,) = viewer.messages(1)
    event = json.loads(message.body)
    assert event["name"] == "zeroed" and "zero taken" in event["message"]


def test_the_feed_listens_on_this_computer_only_and_names_a_busy_port(heli: Heli) -> None:
    with feeds.foxglove_feed(heli, 0) as feed:
        assert feed is not None
        port = int(feed.address.rpartition(":")[2])
        # An address of the loopback network too, which a server for all interfaces would answer on.
        with pytest.raises(OSError), socket.create_connection(("127.0.0.2", port), 5.0):
            pass
        with pytest.raises(PortError, match="give --foxglove another port"):
            feeds.FoxgloveFeed(heli, port)


def test_the_link_does_not_wait_for_a_server_that_hangs(heli: Heli, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(feeds, "_WAITING_PARTS", 3)
    hangs = threading.Event()
    with feeds.foxglove_feed(heli, 0) as feed:
        assert feed is not None
        monkeypatch.setattr(feed, "_send_message", lambda kind, data: hangs.wait(PATIENCE_S))
        before_s = heli.latest.t_s
        heli.wait(0.5)
        assert heli.latest.t_s >= before_s + 0.5 and feed.dropped >= 10
        hangs.set()


@pytest.mark.skipif(not hasattr(os, "getpriority"), reason="this system has no niceness")
def test_link_and_stop_go_before_the_server_on_a_busy_computer(heli: Heli) -> None:
    with feeds.foxglove_feed(heli, 0) as feed:
        assert feed is not None
        assert os.getpriority(os.PRIO_PROCESS, feed.server_pid) > os.getpriority(os.PRIO_PROCESS, 0)


def test_a_server_that_ends_does_not_end_the_session(heli: Heli) -> None:
    with feeds.foxglove_feed(heli, 0) as feed:
        assert feed is not None
        feed._server.kill()
        feed._server.wait()
        before_s = heli.latest.t_s
        heli.wait(0.2)
        assert heli.latest.t_s >= before_s + 0.2


def test_record_and_fly_name_the_address_for_viewers(terminal: Terminal) -> None:
    Path("short.toml").write_text(SHORT_PLAN)
    sil = ("--sil", "--speed", "max", "--foxglove", "0")
    for words in (("record", "--duration", "0.5", "-o", "a.mcap"), ("fly", "short.toml", "--log", "b.mcap")):
        result = terminal(*words, *sil)
        assert result.code == 0 and "viewers: ws://127.0.0.1:" in result.out + result.err
    refused = terminal("dashboard", "--replay", "a.mcap", "--foxglove", "0")
    assert refused.code == 2 and "viewers open a.mcap as a file" in refused.err


@pytest.mark.parametrize(
    ("headers", "is_served"),
    [
        ({}, True),
        ({"Origin": "http://localhost:8080"}, True),
        ({"Origin": "https://app.foxglove.dev"}, True),
        ({"Origin": "file://"}, True),
        ({"Origin": "https://evil.example"}, False),
        ({"Origin": "https://app.foxglove.dev.evil.example"}, False),
        ({"Origin": "http://localhost.evil.example"}, False),
        ({"Origin": "null"}, False),
        ({"Origin": "http://["}, False),
        ({"Host": "evil.example"}, False),
        ({"Host": "["}, False),
    ],
)
def test_pages_of_other_origins_are_refused(headers: dict[str, str], is_served: bool) -> None:
    lines = {"Host": "127.0.0.1:8765", **headers}
    text = "".join(f"{name}: {value}\r\n" for name, value in lines.items())
    assert is_permitted(f"GET / HTTP/1.1\r\n{text}\r\n".encode()) == is_served


def test_a_foreign_page_gets_no_sample_and_a_viewer_does(heli: Heli) -> None:
    with feeds.foxglove_feed(heli, 0) as feed:
        assert feed is not None
        foreign = {"Origin": "https://evil.example"}
        with (
            pytest.raises(InvalidStatus) as refused,
            connect(feed.address, additional_headers=foreign, subprotocols=[PROTOCOL], proxy=None),
        ):
            pass
        assert refused.value.response.status_code == 403
        local = Origin("http://localhost:1")
        with connect(feed.address, origin=local, subprotocols=[PROTOCOL], proxy=None) as viewer:
            assert json.loads(viewer.recv(PATIENCE_S))["op"] == "serverInfo"


def test_a_server_whose_input_ends_at_once_ends_without_an_error() -> None:
    command = [sys.executable, "-m", "heli_host.ui.foxglove_server"]
    ended = subprocess.run(
        command, check=False, stdin=subprocess.DEVNULL, capture_output=True, timeout=PATIENCE_S
    )
    assert (ended.returncode, ended.stdout, ended.stderr) == (0, b"", b"")
