"""The badge shows REAL unless something says that the board is simulated: the safe side of an error."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import pytest
from heli_host.board.heli import Heli
from heli_host.ui.page.cockpit import is_simulated


@pytest.mark.parametrize(
    ("transport", "board", "simulated"),
    [
        ({"url": "/dev/ttyACM0"}, "due", False),
        ({"url": "/dev/pts/3"}, "native", True),
        ({"url": "/dev/pts/3", "rig": "makki2024"}, "due", True),
        ({"url": "/dev/pts/3", "label": "emulated Due, heli.elf"}, "due", True),
    ],
)
def test_a_board_is_simulated_only_if_something_says_so(
    transport: dict[str, Any], board: str, simulated: bool
) -> None:
    session = SimpleNamespace(transport=SimpleNamespace(**transport))
    heli = SimpleNamespace(session=session, info=SimpleNamespace(board=board))
    assert is_simulated(cast(Heli, heli)) is simulated
