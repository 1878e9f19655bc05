"""The board's end of an open link; and a fake board, a line to it, and a host that is connected by it."""

import pytest
from heli_host.board.heli import Heli
from heli_host.link.session import Session

from tests.link.core_harness import Harness, open_harness
from tests.link.fake_board import FakeBoard, FakeLine


@pytest.fixture
def harness() -> Harness:
    return open_harness()


@pytest.fixture
def board() -> FakeBoard:
    return FakeBoard()


@pytest.fixture
def line(board: FakeBoard) -> FakeLine:
    return FakeLine(board)


@pytest.fixture
def session(line: FakeLine) -> Session:
    session = Session(line)
    session.connect()
    return session


@pytest.fixture
def heli(session: Session) -> Heli:
    return Heli(session)
