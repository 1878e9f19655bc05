"""Live output: text rewritten in place on a terminal; for other outputs, a line from time to time."""

from __future__ import annotations

import errno
import sys
import time
from collections.abc import Mapping
from math import degrees
from types import TracebackType
from typing import TYPE_CHECKING, Self

from heli_host.declaration import AXES
from heli_host.errors import printable
from heli_host.ui.cli.say import DATA_ONLY, QUIET, say, say_progress

if TYPE_CHECKING:
    from rich.console import RenderableType
    from rich.live import Live
    from rich.progress import Progress
    from rich.table import Table

    from heli_host.board.samples import Sample
    from heli_host.link.telemetry import LinkCounters

_LINE_EVERY_S = 5.0
"""Interval between lines, if the output goes to a file or another program."""
REFRESH_S = 0.25
"""Interval between updates on a terminal; four per second cost about 1 % of a core."""

_MIN_TOLD = 0.01
"""Share of the work below which no remaining time is shown."""


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


def numbers_table(
    sample: Sample, counts: Mapping[str, int] | None = None, illegal: Mapping[str, int] | None = None
) -> Table:
    """Make the table: a row for each axis and one for the motors."""
    from rich.table import Table

    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0))
    table.add_column("", no_wrap=True)
    for heading in ("is", "setpoint", *(("count",) if counts else ()), *(("bad edges",) if illegal else ())):
        table.add_column(heading, justify="right", no_wrap=True)
    for axis in AXES:
        is_deg = degrees(getattr(sample, f"{axis}_rad"))
        goal_deg = degrees(getattr(sample, f"{axis}_setpoint_rad"))
        row = [axis, f"{is_deg:+8.2f} deg", f"{goal_deg:+8.2f} deg"]
        row += [f"{counts[axis]:+d}"] if counts else []
        if illegal:
            row.append(f"[bold red]{illegal[axis]}[/]" if illegal[axis] else "0")
        table.add_row(*row)
    table.add_row("front, back", f"{sample.front_V:+8.2f} V  ", f"{sample.back_V:+8.2f} V  ")
    return table


class LiveLine:
    """Shows what is happening; a context manager."""

    # None for `is_terminal` asks standard output; ``--quiet`` leaves only the lines that stay.
    # On a terminal a table is rewritten in place; elsewhere a line is printed every few seconds.

    def __init__(self, is_terminal: bool | None = None) -> None:
        self._quiet = QUIET.get()
        self._display = LiveDisplay(_LINE_EVERY_S, False if self._quiet else is_terminal)

    def __enter__(self) -> Self:
        self._display.__enter__()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._display.__exit__(kind, error, trace)

    @property
    def due(self) -> bool:
        """Whether enough time has passed to show something again."""
        return self._display.due

    def show(
        self, sample: Sample, counters: LinkCounters, *, t_s: float, phase: str, left_s: float | None = None
    ) -> None:
        """Show the newest sample, if it is time to."""
        if self._quiet or not self.due:
            return
        head, link = heading(sample, t_s, phase, left_s), link_text(counters)
        if self._display.is_terminal:
            self._display.replace(head, numbers_table(sample), f"link: {link}")
        else:
            self._display.print_line(f"{head} | {_angles_text(sample)} | {link}")

    def say(self, text: str) -> None:
        """Print a line of `text` that stays, above the live one."""
        self._display.say(text)


def heading(sample: Sample, t_s: float, phase: str, left_s: float | None) -> str:
    """Return time, phase and remaining time, such as ``" 12.3 s  sine  closed_loop  8 s left"``."""
    parts = [f"{t_s:6.1f} s", printable(phase), sample.state.name.lower()]
    if sample.fault:
        parts.append(f"fault {sample.fault.name.lower()}")
    if left_s is not None:
        parts.append(f"{max(left_s, 0.0):.0f} s left")
    return "  ".join(parts)


def _angles_text(sample: Sample) -> str:
    """Return the three angles, each with its setpoint, such as ``"elevation +4.9 (+5.0)  pitch ... deg"``."""
    pairs = [(getattr(sample, f"{axis}_rad"), getattr(sample, f"{axis}_setpoint_rad")) for axis in AXES]
    angles = "  ".join(
        f"{axis} {degrees(angle_rad):+6.1f} ({degrees(goal_rad):+6.1f})"
        for axis, (angle_rad, goal_rad) in zip(AXES, pairs, strict=True)
    )
    return f"{angles} deg"


def link_text(counters: LinkCounters) -> str:
    """Return the errors of the link, such as ``"lost 0 ticks, 0 bad frames, 0 retries"``."""
    text = f"lost {counters.ticks_lost} ticks, {counters.frames_bad} bad frames, {counters.retries} retries"
    return f"{text}, {counters.reconnects} reconnects" if counters.reconnects else text


class WorkBar:
    """Shows what is being done, and the time left; a context manager."""

    # None for `is_terminal` asks standard output; ``--quiet`` shows nothing.
    # On a terminal one line is rewritten in place and disappears at the end; elsewhere a line is printed
    # every few seconds.

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
        if now_s - self._shown_s >= _LINE_EVERY_S:
            self._shown_s = now_s
            line = f"{stage}: {100 * done:.0f} %"
            # The first steps do not yet show how long the rest takes.
            if done >= _MIN_TOLD:
                line += f", about {(now_s - self._started_s) * (1.0 - done) / done:.0f} s left"
            say_progress(line)
