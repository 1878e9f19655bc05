"""The log of the page's server: each line is written once, however often its cause occurs."""

from __future__ import annotations

import logging

from heli_host.errors import printable

_MAX_CAUSES = 200
"""Greatest number of different lines: a client with endless invalid requests must not fill a disk."""


class Notes:
    """The server's log."""

    def __init__(self) -> None:
        self._log = logging.getLogger("heli_host.ui.page")
        self._seen: set[str] = set()

    def warn(self, cause: str) -> None:
        """Write one line, unless the same line was written before."""
        line = printable(" ".join(cause.split()))
        if line in self._seen or len(self._seen) > _MAX_CAUSES:
            return
        self._seen.add(line)
        more = "; further lines are left out" if len(self._seen) > _MAX_CAUSES else ""
        self._log.warning("page: %s%s", line, more)
