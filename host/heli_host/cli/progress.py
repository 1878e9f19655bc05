"""The live line: time, angles against setpoints, state and the health of the link, while something flies."""

from __future__ import annotations

import errno
import sys
import time
from types import TracebackType
from typing import TYPE_CHECKING, Self

from heli_host.errors import printable

if TYPE_CHECKING:
    from rich.live import Live

    from heli_host.link.accounting import LinkCounters
    from heli_host.samples import Sample

REFRESH_S = 0.25
"""On a terminal; four a second cost about 1 % of a core."""
LINE_EVERY_S = 5.0
"""When the output goes to a file or another program."""


class LiveLine:
    """Shows what is happening; a context manager. None for `is_terminal` asks standard output.

    On a terminal a few lines are rewritten in place; elsewhere a line is printed every few seconds.
    """

    def __init__(self, is_terminal: bool | None = None) -> None:
        self._is_terminal = sys.stdout.isatty() if is_terminal is None else is_terminal
        self._live: Live | None = None
        self._shown_s = float("-inf")

    def __enter__(self) -> Self:
        if self._is_terminal:
            from rich.console import Console
            from rich.live import Live

            self._live = Live(console=Console(highlight=False), auto_refresh=False, transient=True)
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
        interval_s = REFRESH_S if self._is_terminal else LINE_EVERY_S
        return time.monotonic() - self._shown_s >= interval_s

    def show(
        self, sample: Sample, counters: LinkCounters, *, t_s: float, phase: str, left_s: float | None = None
    ) -> None:
        """Show the newest sample, if it is time to.

        Parameters
        ----------
        t_s : float
            Device time since the beginning [s].
        phase : str
            What is being flown.
        left_s : float or None
            Device time left [s]; None when nobody knows.
        """
        if not self.due:
            return
        self._shown_s = time.monotonic()
        head = heading(sample, t_s, phase, left_s)
        angles = angles_text(sample)
        link = link_text(counters)
        try:
            self._print(head, angles, link, "" if counters.ticks_lost == 0 else "yellow")
        except OSError as error:
            # A terminal that is gone says so by SIGHUP as well, and that lands.
            if error.errno != errno.EIO:
                raise

    def _print(self, head: str, angles: str, link: str, style: str) -> None:
        if self._live is None:
            print(f"{head} | {angles} | {link}", flush=True)
            return
        from rich.text import Text

        self._live.update(
            Text.assemble((head, "bold"), "\n", angles, "\n", (f"link: {link}", style), no_wrap=True),
            refresh=True,
        )

    def say(self, text: str) -> None:
        """Print a line of `text` that stays, above the live one."""
        if self._live is None:
            print(text, flush=True)
        else:
            self._live.console.print(text, markup=False)


def heading(sample: Sample, t_s: float, phase: str, left_s: float | None) -> str:
    """Say when, what and how long still, such as ``" 12.3 s  sine  closed_loop  8 s left"``.

    Parameters
    ----------
    t_s : float
        Device time since the beginning [s].
    phase : str
        What is being flown.
    left_s : float or None
        Device time left [s].
    """
    parts = [f"{t_s:6.1f} s", printable(phase), sample.state.name.lower()]
    if sample.fault:
        parts.append(f"fault {sample.fault.name.lower()}")
    if left_s is not None:
        parts.append(f"{max(left_s, 0.0):.0f} s left")
    return "  ".join(parts)


def angles_text(sample: Sample) -> str:
    """Say the three angles, each with its setpoint, such as ``"elevation +4.9 (+5.0)  pitch ... deg"``."""
    from math import degrees

    from heli_host.declaration import AXES

    pairs = [(getattr(sample, f"{axis}_rad"), getattr(sample, f"{axis}_setpoint_rad")) for axis in AXES]
    angles = "  ".join(
        f"{axis} {degrees(angle_rad):+6.1f} ({degrees(goal_rad):+6.1f})"
        for axis, (angle_rad, goal_rad) in zip(AXES, pairs, strict=True)
    )
    return f"{angles} deg"


def link_text(counters: LinkCounters) -> str:
    """Say how the link fares, such as ``"lost 0 ticks, 0 bad frames, 0 retries"``."""
    text = f"lost {counters.ticks_lost} ticks, {counters.frames_bad} bad frames, {counters.retries} retries"
    return f"{text}, {counters.reconnects} reconnects" if counters.reconnects else text
