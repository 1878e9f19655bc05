"""The serial line has the timing of a Due's programming port, and loses bytes where that one would."""

from __future__ import annotations

import pytest

from tests.sil.harness import Host, hello_frame, world

pytestmark = pytest.mark.medium


def test_25_bytes_a_millisecond_reach_the_board() -> None:
    line = world()
    line.advance(1, bytes(1000))
    assert line.native.line_counters()["to_board_bytes"] == 25
    line.advance(20)
    assert line.native.line_counters()["to_board_bytes"] == 525
    line.advance(100)
    assert line.native.line_counters()["to_board_bytes"] == 1000
    assert line.native.line_counters()["to_board_overflow"] == 0


def test_bytes_for_the_board_wait_until_the_line_has_carried_the_ones_before() -> None:
    line = world()
    line.advance(1, bytes(100))
    assert line.native.to_board_waiting == 75


def test_a_host_that_writes_faster_than_the_line_for_seconds_loses_bytes_and_they_are_counted() -> None:
    line = world()
    line.advance(1, bytes(70_000))
    counters = line.native.line_counters()
    assert counters["to_board_overflow"] == 70_000 - 65_536


def test_bytes_reach_the_host_in_bursts_every_4_ms_or_when_96_wait() -> None:
    host = Host()
    host.hello()
    last_us, sizes, gaps_us = None, [], []
    for _ in range(2000):
        data = host.world.advance(1)
        if not data:
            continue
        sizes.append(len(data))
        now_us = host.world.tick * 1000
        if last_us is not None:
            gaps_us.append(now_us - last_us)
        last_us = now_us
    # 100 bytes are four milliseconds of line: every burst is at least three of them apart.
    assert min(gaps_us) >= 3000
    assert max(sizes) <= 128
    assert sum(sizes) <= 25 * 2000


def test_every_burst_falls_on_the_bridges_timer_when_little_is_sent() -> None:
    host = Host()
    ticks = []
    for tick in range(1, 400):
        if host.world.advance(1, hello_frame(tick) if tick % 50 == 1 else b""):
            ticks.append(tick)
        if len(ticks) == 3:
            break
    # Timer 0 of the 16U2 runs over every 4.096 ms; bytes show at the end of that millisecond.
    assert ticks
    timer = {-(-k * 4096 // 1000) for k in range(1, 120)}
    assert set(ticks) <= timer


def test_a_host_that_does_not_read_loses_bytes_and_the_rest_arrives() -> None:
    host = Host()
    host.hello()
    host.wait(200)
    before = host.world.native.line_counters()
    host.world.host_reading = False
    assert host.world.advance(1000) == b""
    lost = host.world.native.line_counters()["to_host_overflow"] - before["to_host_overflow"]
    assert lost > 1000
    host.world.host_reading = True
    # The bytes in the ring of 128 come first.
    assert 0 < len(host.world.advance(5)) <= 128 + 5 * 25
