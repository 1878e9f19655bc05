"""The host answers any sound or damaged frame with a one-line error, or goes on."""

from __future__ import annotations

import math

import numpy as np
import pytest
from heli_host.declaration import CHANNELS, Channel, Event, EventMessage, State
from heli_host.link.channels import declared
from heli_host.link.events import event_text
from heli_host.link.session import Session
from heli_host.link.telemetry import Ticks

from tests.channels.groups import row_of
from tests.link.fake_board import FakeBoard, FakeLine
from tests.link.fuzz_host import fuzz_host
from tests.running.long import samples


@pytest.mark.slow
def test_a_million_frames_raise_only_errors_of_the_package() -> None:
    frames = samples(1_000_000, 15_000)
    sent, broken = fuzz_host(2, frames)
    assert sent >= frames
    assert not broken, broken.most_common(5)


@pytest.mark.medium
@pytest.mark.parametrize("value", [math.inf, -math.inf, math.nan, 2.0**127, 0.5])
@pytest.mark.parametrize("kind", [*Event, 200])
def test_an_event_may_carry_any_number(kind: int, value: float) -> None:
    board = FakeBoard()
    session = Session(FakeLine(board))
    session.connect()
    session.wait(0.1)
    board.send(EventMessage(board.tick, kind, 1, 1, value))
    session.wait_for(lambda: False, 0.5)
    assert session.connected
    assert session.counters.restarts == 0
    [event] = [event for event in session.events if event.message is not None and event.message.kind == kind]
    assert event.text == event_text(EventMessage(0, kind, 1, 1, value))


def test_a_sample_of_a_state_that_nobody_declared_is_refused_and_counted() -> None:
    board = FakeBoard()
    session = Session(FakeLine(board))
    received: list[Ticks] = []
    session.subscribe_ticks(received.append)
    session.connect()
    session.wait(0.1)
    board.state = 9  # type: ignore[assignment]
    session.wait_for(lambda: False, 0.2)
    board.state = State.IDLE
    session.wait(0.2)
    counters = session.counters
    delivered = sum(map(len, received))
    assert all(raw in list(State) for ticks in received for raw in ticks.raw[:, Channel.STATE])
    assert counters.frames_bad >= 1
    assert counters.ticks_lost >= 180
    assert counters.ticks_received == delivered
    assert delivered + counters.ticks_lost == int(received[-1].tick[-1]) - int(received[0].tick[0]) + 1


def test_every_declared_value_passes_and_no_other() -> None:
    for channel in (Channel.STATE, Channel.FAULT, Channel.TRIGGER):
        kind = CHANNELS[channel].kind
        assert kind is not None
        for number in (*range(-1, 260), 2**31 - 1, -(2**31)):
            raw = np.array([row_of({channel: number})], np.int32)
            assert declared(raw).tolist() == [number in [int(value) for value in kind]], (channel, number)
    assert declared(np.array([row_of({Channel.FLAGS: 255, Channel.FRONT: -5000})], np.int32)).all()
