"""Lines in the server's log: one for each cause, however often it comes."""

from __future__ import annotations

import logging

from heli_host.errors import printable

_MAX_CAUSES = 200
"""Different lines that are logged: who sends nonsense without end must not fill a disk with it."""


class Notes:
    """The server's log."""

    def __init__(self) -> None:
        self._log = logging.getLogger("heli_host.page")
        self._seen: set[str] = set()

    def warn(self, cause: str) -> None:
        """Write one line, unless the same line was written before.

        Parameters
        ----------
        cause : str
            What went wrong, and for whom.
        """
        line = printable(" ".join(cause.split()))
        if line in self._seen or len(self._seen) > _MAX_CAUSES:
            return
        self._seen.add(line)
        more = "; further lines are left out" if len(self._seen) > _MAX_CAUSES else ""
        self._log.warning("page: %s%s", line, more)
