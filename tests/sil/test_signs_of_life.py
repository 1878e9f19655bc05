"""How often a host repeats setpoints and pings, whatever it believes of the device's speed."""

from __future__ import annotations

from collections import Counter

import heli_host
import pytest
from heli_host.declaration import Axes, MessageId
from heli_host.link.clock import ClockEstimate, ClockFit
from heli_host.link.frames import FrameParser

from tests.fly.fault_flights import world_of


@pytest.mark.medium
def test_a_clock_that_seems_to_race_does_not_flood_the_board(monkeypatch: pytest.MonkeyPatch) -> None:
    # Result of the fit when a port that was read slowly delivers all waiting bytes.
    racing = ClockEstimate(0, 0.0, 1e-9, 0.0, 0.0)
    sent: Counter[int] = Counter()
    with heli_host.connect("sil://?seed=3&speed=max") as heli:
        heli.arm()
        heli.control(Axes.ELEVATION | Axes.PITCH | Axes.TRAVEL)
        to_board, parser = world_of(heli).to_board, FrameParser()
        carry = to_board.pass_through

        def count(data: bytes) -> bytes:
            sent.update(frame.id for frame in parser.feed(data))
            return carry(data)

        monkeypatch.setattr(to_board, "pass_through", count)
        monkeypatch.setattr(ClockFit, "estimate", lambda fit: racing)
        heli.session.wait_for(lambda: False, 1.0, step_s=0.002)
    assert 8 <= sent[MessageId.SETPOINT] <= 25
    assert sent[MessageId.PING] <= 25
