"""The handshake: whether the board has welcomed this session, and what kind of welcome it was."""

from __future__ import annotations

import math
from enum import Enum, auto

from heli_host.declaration import LINK_HASH, LINK_VERSION, HelloMessage, Result, WelcomeMessage
from heli_host.errors import LinkVersionMismatch
from heli_host.link.requests import RequestNumbers

HELLO_INTERVAL_S = 0.1


class Welcome(Enum):
    """Meaning of a welcome for this session."""

    IGNORED = auto()
    """It answers no hello of this handshake, or refuses the session: `Handshake.mismatch` is then set."""
    FIRST = auto()
    SAME_START = auto()
    """The link was lost or silent, and the board has run on meanwhile."""
    RESTARTED = auto()


class Handshake:
    """Hello and welcome. Part of an `Engine`: its callers serialise all calls.

    It owns whether the session is open, and the newest welcome. While it is not open, it greets every
    `HELLO_INTERVAL_S`.
    """

    def __init__(self, session_number: int, numbers: RequestNumbers) -> None:
        self.is_open = False
        self.welcome: WelcomeMessage | None = None
        self.mismatch: LinkVersionMismatch | None = None
        self.unreachable_since_s: float | None = None
        self.reconnects = 0
        self.restarts = 0
        self._session_number = session_number
        self._numbers = numbers
        self._hello_request = numbers.take()
        # Before any host time: the first greeting is due immediately.
        self._next_hello_s = -math.inf

    @property
    def unreachable(self) -> bool:
        """Whether a board that welcomed this session before does not answer now."""
        return self.welcome is not None and not self.is_open

    def begin(self, now_s: float) -> None:
        """Greet again, because the board does not answer or has restarted."""
        if self.is_open or self.unreachable_since_s is None:
            self.unreachable_since_s = now_s
        self.is_open = False
        self._next_hello_s = now_s
        self._hello_request = self._numbers.take()

    def due_hello(self, now_s: float) -> HelloMessage | None:
        """Return a hello if one is due, for the caller to send."""
        if now_s < self._next_hello_s:
            return None
        self._next_hello_s = now_s + HELLO_INTERVAL_S
        return HelloMessage(self._hello_request, LINK_HASH, self._session_number)

    def take_welcome(self, welcome: WelcomeMessage, *, is_behind: bool) -> Welcome:
        """Open the session, if the welcome answers the present hello and the declarations are the same."""
        if self.is_open or welcome.request != self._hello_request:
            return Welcome.IGNORED
        if welcome.result != Result.OK or welcome.link_hash != LINK_HASH:
            self.mismatch = LinkVersionMismatch(
                LINK_VERSION,
                LINK_HASH,
                f"{welcome.link_major}.{welcome.link_minor}",
                welcome.link_hash,
                f"{welcome.firmware_major}.{welcome.firmware_minor}.{welcome.firmware_patch}",
            )
            return Welcome.IGNORED
        previous = self.welcome
        self.is_open, self.welcome, self.unreachable_since_s = True, welcome, None
        if previous is None:
            return Welcome.FIRST
        self.reconnects += 1
        # Either condition alone may fail: the boot id of another start is the same by chance once in 2^24,
        # and the tick may be higher although the board restarted, if that was long ago.
        if welcome.boot_id == previous.boot_id and not is_behind:
            return Welcome.SAME_START
        self.restarts += 1
        return Welcome.RESTARTED
