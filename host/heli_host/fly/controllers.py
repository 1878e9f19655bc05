"""The compiled controllers of a board, by name."""

from __future__ import annotations

from typing import TYPE_CHECKING

from heli_host.declaration import PARAMS, ControllerMessage, ControllerReadMessage, Param

if TYPE_CHECKING:
    from heli_host.link.session import Session


def controller_names(session: Session) -> tuple[str, ...]:
    """Ask the board for the names of its compiled controllers."""
    # No board has more; a damaged answer must not keep the host asking.
    count = min(_ask_row(session, 0).count, round(PARAMS[Param.CONTROLLER].max) + 1)
    return tuple(controller_name(session, row) for row in range(count))


def controller_name(session: Session, selected: float) -> str:
    """Ask the board for the name of one controller."""
    answer = _ask_row(session, round(selected))
    words = (answer.name_0, answer.name_1, answer.name_2, answer.name_3)
    text = b"".join(word.to_bytes(4, "little") for word in words).rstrip(b"\0")
    return text.decode("ascii", "replace")


def _ask_row(session: Session, row: int) -> ControllerMessage:
    return ControllerMessage.unpack(session.request(ControllerReadMessage(0, row & 0xFF)).payload)
