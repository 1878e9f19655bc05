"""Boards that tests of the flight code begin with."""

import pytest

from tests.flight.harness import Harness


@pytest.fixture
def harness() -> Harness:
    """A board with a session, its arm at rest on the table."""
    return Harness()


@pytest.fixture
def flying(harness: Harness) -> Harness:
    """The same in closed loop on all axes."""
    harness.fly()
    return harness
