"""Progress bar for long work without a flight: the present stage, and the remaining time."""

from __future__ import annotations

import sys
import time
from types import TracebackType
from typing import TYPE_CHECKING, Self

from heli_host.errors import printable
from heli_host.ui.cli.live_display import LINE_EVERY_S
from heli_host.ui.cli.say import DATA_ONLY, QUIET, say_progress

if TYPE_CHECKING:
    from rich.progress import Progress

_MIN_TOLD = 0.01
"""Share of the work below which no remaining time is shown."""


class WorkBar:
    """Shows what is being done, and the time left; a context manager. None for `is_terminal` asks standard
    output; ``--quiet`` shows nothing.

    On a terminal one line is rewritten in place and disappears at the end; elsewhere a line is printed every
    few seconds.
    """

    def __init__(self, is_terminal: bool | None = None) -> None:
        self._is_terminal = sys.stdout.isatty() if is_terminal is None else is_terminal
        self._is_terminal &= not QUIET.get()
        self._bar: Progress | None = None
        self._started_s = self._shown_s = time.monotonic()

    def __enter__(self) -> Self:
        if self._is_terminal:
            from rich.console import Console
            from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

            self._bar = Progress(
                TextColumn("{task.description}", markup=False),
                BarColumn(),
                TaskProgressColumn(),
                TimeRemainingColumn(),
                TextColumn("left"),
                # rich's own console is one for the process and keeps the first terminal that it saw.
                console=Console(stderr=DATA_ONLY.get()),
                transient=True,
            )
            self._bar.start()
            self._bar.add_task("", total=1.0)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._bar is not None:
            self._bar.stop()

    def show(self, stage: str, done: float) -> None:
        """Show the `stage` of the work in a few words, and the share of it all that is `done`, 0 to 1."""
        if self._bar is not None:
            self._bar.update(self._bar.task_ids[0], description=printable(stage), completed=done)
            return
        now_s = time.monotonic()
        if now_s - self._shown_s >= LINE_EVERY_S:
            self._shown_s = now_s
            line = f"{stage}: {100 * done:.0f} %"
            # The first steps do not yet show how long the rest takes.
            if done >= _MIN_TOLD:
                line += f", about {(now_s - self._started_s) * (1.0 - done) / done:.0f} s left"
            say_progress(line)
