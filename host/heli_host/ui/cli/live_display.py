"""Live display: text rewritten in place on a terminal; for other outputs, a line from time to time."""

from __future__ import annotations

import errno
import sys
import time
from types import TracebackType
from typing import TYPE_CHECKING, Self

from heli_host.errors import printable
from heli_host.ui.cli.say import DATA_ONLY, say

if TYPE_CHECKING:
    from rich.console import RenderableType
    from rich.live import Live

LINE_EVERY_S = 5.0
"""Interval between lines, if the output goes to a file or another program."""
REFRESH_S = 0.25
"""Interval between updates on a terminal; four per second cost about 1 % of a core."""


class LiveDisplay:
    """Lines and tables that are rewritten in their place; a context manager."""

    def __init__(self, line_every_s: float, is_terminal: bool | None = None) -> None:
        stream = sys.stderr if DATA_ONLY.get() else sys.stdout
        self.is_terminal = stream.isatty() if is_terminal is None else is_terminal
        self._line_every_s = line_every_s
        self._live: Live | None = None
        self._shown_s = float("-inf")

    def __enter__(self) -> Self:
        if self.is_terminal:
            from rich.console import Console
            from rich.live import Live

            self._live = Live(
                console=Console(highlight=False, stderr=DATA_ONLY.get()), auto_refresh=False, transient=True
            )
            self._live.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._live is not None:
            self._live.stop()

    @property
    def due(self) -> bool:
        """Whether enough time has passed to show something again."""
        interval_s = REFRESH_S if self.is_terminal else self._line_every_s
        return time.monotonic() - self._shown_s >= interval_s

    def replace(self, *parts: RenderableType) -> None:
        """Replace the displayed lines and tables."""
        from rich.console import Group
        from rich.text import Text

        self._shown_s = time.monotonic()
        if self._live is None:
            return
        first = Text(printable(parts[0]), "bold") if isinstance(parts[0], str) else parts[0]
        others = [Text(printable(part)) if isinstance(part, str) else part for part in parts[1:]]
        try:
            self._live.update(Group(first, *others), refresh=True)
        except OSError as error:
            # The terminal was closed. Its SIGHUP, which also arrives, ends the flight with a landing.
            if error.errno != errno.EIO:
                raise

    def print_line(self, text: str) -> None:
        """Print one line, for outputs on which nothing can be rewritten."""
        self._shown_s = time.monotonic()
        say(text)

    def say(self, text: str) -> None:
        """Print a permanent line above the lines that are rewritten."""
        if self._live is None:
            say(text)
        else:
            self._live.console.print(printable(text), markup=False)
