"""The compiled controllers of a board, by name."""

from __future__ import annotations

from typing import TYPE_CHECKING

from heli_host.declaration import ControllerMessage, ControllerReadMessage

if TYPE_CHECKING:
    from heli_host.link.session import Session


def controller_names(session: Session) -> tuple[str, ...]:
    """Ask the board for the names of its compiled controllers.

    Parameters
    ----------
    session : Session
        Connected.

    Returns
    -------
    tuple of str
        One name per value of the parameter ``controller``, from 0 on.
    """
    names: list[str] = []
    count = 1
    while len(names) < count:
        answer = ControllerMessage.unpack(session.request(ControllerReadMessage(0, len(names))).payload)
        count = answer.count
        words = (answer.name_0, answer.name_1, answer.name_2, answer.name_3)
        text = b"".join(word.to_bytes(4, "little") for word in words).rstrip(b"\0")
        names.append(text.decode("ascii", "replace"))
    return tuple(names)


def controller_name(session: Session, selected: float) -> str:
    """Return the name of the selected controller.

    Parameters
    ----------
    session : Session
        Connected.
    selected : float
        The board's parameter ``controller``.
    """
    return controller_names(session)[round(selected)]
