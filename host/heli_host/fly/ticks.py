"""Device time of a flight, from the newest sample."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from heli_host.link.session import Session

_LONGEST_WAIT_S = 2.0


def newest_tick(session: Session) -> int:
    """Return the tick of the newest sample; 0 before the first."""
    newest = session.latest
    return newest[0] if newest is not None else 0


def wait_ticks(session: Session, count: int) -> None:
    """Wait for some milliseconds of device time, for at most 2 s."""
    last_tick = newest_tick(session) + count
    session.wait_for(lambda: newest_tick(session) >= last_tick, _LONGEST_WAIT_S)
