"""Who flies: one pilot, who hands control over when asked, and is there only while his page answers."""

from __future__ import annotations

import threading
from dataclasses import dataclass

PRESENT_S = 0.5
"""How old the pilot's last sign may be for setpoints to go out [s]: ten are due in it.
Older, they are missing to the board, which holds after ``setpoint_hold_s`` more and lands after
``setpoint_land_s``. A closed or crashed page is told at once by its socket."""
ABSENT_S = 3.0
"""How long the pilot may be away for a request to be granted without him [s]: a page that loads anew keeps
its seat."""


@dataclass
class _Client:
    name: str
    may_fly: bool
    connected: bool
    beat_s: float


class ControlLease:
    """Clients by their ids, and which of them flies; may be asked from any thread.

    Attributes
    ----------
    pilot : str or None
        Id of the pilot; kept while he is away, until somebody asks.
    asking : str or None
        Id of who asks for control.
    shared : bool
        Whether clients that do not fly may change parameters.
    """

    def __init__(self) -> None:
        self.pilot: str | None = None
        self.asking: str | None = None
        self.shared = False
        self._clients: dict[str, _Client] = {}
        self._lock = threading.RLock()

    def join(self, client: str, name: str, now_s: float, *, may_fly: bool = True) -> bool:
        """Add a client; the first that may fly is the pilot. False when one of this id is connected.

        Parameters
        ----------
        client : str
            Id.
        name : str
            Name for people.
        now_s : float
            Host time [s].
        may_fly : bool
            Whether it becomes the pilot where there is none.
        """
        with self._lock:
            known = self._clients.get(client)
            if known is not None and known.connected:
                return False
            self._clients[client] = _Client(name, may_fly, True, now_s)
            if self.pilot is None and may_fly:
                self.pilot = client
            return True

    def leave(self, client: str) -> None:
        """Note that a client is gone; a pilot keeps the seat until somebody asks for it.

        Parameters
        ----------
        client : str
            Id.
        """
        with self._lock:
            if client in self._clients:
                self._clients[client].connected = False
            if self.asking == client:
                self.asking = None
            if client != self.pilot:
                self._clients.pop(client, None)

    def beat(self, client: str, now_s: float) -> None:
        """Note a sign of life.

        Parameters
        ----------
        client : str
            Id.
        now_s : float
            Host time [s].
        """
        with self._lock:
            if client in self._clients:
                self._clients[client].beat_s = now_s

    def pilot_age_s(self, now_s: float) -> float:
        """How old the pilot's last sign is [s]; infinite without a pilot who is connected.

        Parameters
        ----------
        now_s : float
            Host time [s].
        """
        # Asked with the link's lock held: what it reads are single references, so it takes no lock of its
        # own.
        pilot = self._clients.get(self.pilot or "")
        return now_s - pilot.beat_s if pilot is not None and pilot.connected else float("inf")

    def present(self, now_s: float) -> bool:
        """Whether the pilot's page lives.

        Parameters
        ----------
        now_s : float
            Host time [s].
        """
        return self.pilot_age_s(now_s) <= PRESENT_S

    def ask(self, client: str, now_s: float) -> bool:
        """Ask for control; True when it is had at once, because nobody is there to be asked.

        Parameters
        ----------
        client : str
            Id of who asks.
        now_s : float
            Host time [s].
        """
        with self._lock:
            if client == self.pilot:
                return True
            if self.pilot is None or self.pilot_age_s(now_s) > ABSENT_S:
                self._grant(client)
                return True
            self.asking = client
            return False

    def answer(self, client: str, grant: bool) -> bool:
        """Answer who asks; only the pilot can. True when control was handed over.

        Parameters
        ----------
        client : str
            Id of who answers.
        grant : bool
            Whether to hand control over.
        """
        with self._lock:
            if client != self.pilot or self.asking is None:
                return False
            if grant:
                self._grant(self.asking)
            self.asking = None
            return grant

    def name(self, client: str | None) -> str:
        """Name of a client for people, empty for nobody.

        Parameters
        ----------
        client : str or None
            Id.
        """
        with self._lock:
            known = self._clients.get(client or "")
            return known.name if known is not None else ""

    def count(self) -> int:
        """How many are connected."""
        with self._lock:
            return sum(one.connected for one in self._clients.values())

    def _grant(self, client: str) -> None:
        before, self.pilot, self.asking = self.pilot, client, None
        if before is not None and before in self._clients and not self._clients[before].connected:
            del self._clients[before]
