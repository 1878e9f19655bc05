"""The control lease: one client is the pilot, until it hands control over or its page stops answering."""

from __future__ import annotations

import threading
from dataclasses import dataclass

PRESENT_S = 0.5
"""Largest age of the pilot's last sign of life at which setpoints are sent [s].

A page sends ten signs of life in that time. When they stop, the board gets no more setpoints: it holds level
after another ``setpoint_hold_s``, and lands after ``setpoint_land_s``. A page that was closed or has crashed
counts as absent immediately, because its socket closes. With a shorter time, a busy browser would interrupt
the
flight; with a longer one, a frozen page would keep the board flying for longer."""
ABSENT_S = 3.0
"""Absence of the pilot after which another client gets control without the pilot's answer [s]. Shorter: a
page that is reloaded loses control. Longer: a dead page keeps control."""


@dataclass
class _Client:
    name: str
    may_fly: bool
    connected: bool
    beat_s: float


class ControlLease:
    """The connected clients, and which of them is the pilot. All methods may be called from any thread.

    Nothing here talks to the board. `present` decides whether setpoints are sent.
    """

    def __init__(self) -> None:
        self.pilot: str | None = None
        self.asking: str | None = None
        self.shared = False
        self._clients: dict[str, _Client] = {}
        self._lock = threading.RLock()

    def join(self, client: str, name: str, now_s: float, *, may_fly: bool = True) -> bool:
        """Add a client. It becomes the pilot if there is none and `may_fly` is true."""
        with self._lock:
            registered = self._clients.get(client)
            if registered is not None and registered.connected:
                return False
            self._clients[client] = _Client(name, may_fly, True, now_s)
            if self.pilot is None and may_fly:
                self.pilot = client
            return True

    def leave(self, client: str) -> None:
        """Mark a client as disconnected and withdraw its request for control.

        A disconnected pilot keeps the lease until another client asks for it, but counts as absent: no
        setpoints are sent.
        """
        with self._lock:
            if client in self._clients:
                self._clients[client].connected = False
            if self.asking == client:
                self.asking = None
            if client != self.pilot:
                self._clients.pop(client, None)

    def beat(self, client: str, now_s: float) -> None:
        """Record a sign of life of a client."""
        with self._lock:
            if client in self._clients:
                self._clients[client].beat_s = now_s

    def pilot_age_s(self, now_s: float) -> float:
        """Return the age of the pilot's last sign of life [s]; infinite if no pilot is connected."""
        # Called with the link's lock held. It reads single references only, so it needs no lock; taking one
        # could deadlock with a thread that holds it and waits for the link.
        pilot = self._clients.get(self.pilot or "")
        return now_s - pilot.beat_s if pilot is not None and pilot.connected else float("inf")

    def present(self, now_s: float) -> bool:
        """Whether the pilot's page has given a sign of life within `PRESENT_S`."""
        return self.pilot_age_s(now_s) <= PRESENT_S

    def absence(self, now_s: float) -> str:
        """Return in words why the pilot's page sends no setpoints; empty while it is present."""
        age_s = self.pilot_age_s(now_s)
        if age_s <= PRESENT_S:
            return ""
        if self.pilot is None:
            return "no page has the control"
        return "the pilot's page was closed" if age_s == float("inf") else "the pilot's page does not answer"

    def ask(self, client: str, now_s: float) -> bool:
        """Request control for a client."""
        with self._lock:
            if client == self.pilot:
                return True
            if self.pilot is None or self.pilot_age_s(now_s) > ABSENT_S:
                self._grant(client)
                return True
            self.asking = client
            return False

    def answer(self, client: str, grant: bool) -> bool:
        """Answer the pending request for control."""
        with self._lock:
            if client != self.pilot or self.asking is None:
                return False
            if grant:
                self._grant(self.asking)
            self.asking = None
            return grant

    def name(self, client: str | None) -> str:
        """Return the display name of a client; empty if it is unknown or None."""
        with self._lock:
            registered = self._clients.get(client or "")
            return registered.name if registered is not None else ""

    def count(self) -> int:
        """Return the number of connected clients."""
        with self._lock:
            return sum(client.connected for client in self._clients.values())

    def _grant(self, client: str) -> None:
        before, self.pilot, self.asking = self.pilot, client, None
        if before is not None and before in self._clients and not self._clients[before].connected:
            del self._clients[before]
