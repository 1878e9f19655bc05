"""A Ctrl-C at any moment leaves no lock held: the reading thread would wait for it and send nothing more."""

from __future__ import annotations

import contextlib
import random
import signal
import threading

import pytest
from heli_host.link.engine import Engine
from heli_host.link.session import Driver, Subscribers

from tests.link.fake_board import FakeBoard, FakeLine

pytestmark = pytest.mark.medium

INTERRUPTS = 200


def interrupted(*_: object) -> None:
    raise KeyboardInterrupt


def test_an_interrupt_at_any_moment_leaves_the_driver_s_lock_free() -> None:
    moments = random.Random(1)
    before = signal.signal(signal.SIGALRM, interrupted)
    try:
        for _ in range(INTERRUPTS):
            driver = Driver(FakeLine(FakeBoard()), Engine(1), Subscribers(), 1.0)
            with contextlib.suppress(KeyboardInterrupt):
                signal.setitimer(signal.ITIMER_REAL, moments.uniform(50e-6, 150e-6))
                while True:
                    with driver.lock:
                        pass
            free: list[bool] = []
            other = threading.Thread(target=lambda: free.append(driver.lock.acquire(timeout=1.0)))  # noqa: B023
            other.start()
            other.join()
            assert free == [True]
    finally:
        signal.signal(signal.SIGALRM, before)
