"""Connecting to a board."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from heli_host.board.heli import HISTORY_S, Heli
from heli_host.declaration import BAUD
from heli_host.link.session import HANDSHAKE_TIMEOUT_S, RECONNECT_TIMEOUT_S, Session
from heli_host.link.transport import open_transport

if TYPE_CHECKING:
    from heli_host.data.log.summary import FlightSummary


def connect(
    url: str = "sil://",
    *,
    baud: int = BAUD,
    reset_board: bool = False,
    keep_alive: bool = True,
    land_on_exit: bool = True,
    history_s: float = HISTORY_S,
    handshake_timeout_s: float = HANDSHAKE_TIMEOUT_S,
    reconnect_timeout_s: float = RECONNECT_TIMEOUT_S,
    session_number: int | None = None,
) -> Heli:
    """Connect to a board, physical or simulated. The motors are not touched.

    Parameters
    ----------
    url : str
        ``/dev/ttyACM0``, ``COM3``, ``socket://host:port``, or ``sil://?rig=makki2024&seed=1&speed=max``.
    baud : int
        Rate of a serial port [baud].
    reset_board : bool
        True resets a Due after opening its port: running motors go off, an arm in the air falls.
    keep_alive : bool
        True repeats the last setpoint ten times per second; see `heli_host.Heli`.
    land_on_exit : bool
        False switches the motors off at the end of a ``with`` block without an error, instead of landing.
    history_s : float
        Length of the history that `Heli.samples` can return [s].
    handshake_timeout_s : float
        Longest wait for the board's welcome [s].
    reconnect_timeout_s : float
        Time for which a lost board is searched [s].
    session_number : int or None
        Number by which the board distinguishes this session. None: random over a port, 1 in lockstep.

    Returns
    -------
    Heli
        Connected; use it in a ``with`` block.

    Raises
    ------
    LinkError
        The board cannot be reached; one of `PortError`, `BadBaud`, `HandshakeTimeout`, `WrongDevice`,
        `LinkVersionMismatch`, `LinkLost`.

    Examples
    --------
    >>> import heli_host
    >>> with heli_host.connect("sil://") as heli:
    ...     heli.take_off(elevation_deg=0.0)
    ...     heli.setpoint(travel_deg=20.0)
    ...     heli.wait(8.0)
    ...     heli.land()
    ...     flown = heli.samples()
    """
    session = Session(
        open_transport(url, baud=baud, reset_board=reset_board),
        session_number=session_number,
        handshake_timeout_s=handshake_timeout_s,
        reconnect_timeout_s=reconnect_timeout_s,
    )
    try:
        session.connect()
        return Heli(
            session,
            keep_alive=keep_alive,
            land_on_exit=land_on_exit,
            history_s=history_s,
            fly_plans=_fly_plans,
        )
    except BaseException:
        # After an interrupt, too, the port must not stay open.
        session.close()
        raise


def _fly_plans(heli: Heli, plans: Any, **options: Any) -> FlightSummary:
    """Fly plans with `heli_host.fly.runner.fly`, which is loaded for the first flight."""
    from heli_host.fly.runner import fly

    return fly(heli, plans, **options)
