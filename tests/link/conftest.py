"""A fake board, a line to it, and what is connected to it by that line."""

from __future__ import annotations

import pytest
from heli_host.board.heli import Heli
from heli_host.link.session import Session

from tests.link.fake_board import FakeBoard, FakeLine


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
