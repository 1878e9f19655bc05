"""The live line during a flight: time, angles with setpoints, state, and quality of the link."""

from __future__ import annotations

from types import TracebackType
from typing import TYPE_CHECKING, Self

from heli_host.errors import printable
from heli_host.ui.cli.live_display import LINE_EVERY_S, LiveDisplay
from heli_host.ui.cli.live_table import numbers_table
from heli_host.ui.cli.say import QUIET

if TYPE_CHECKING:
    from heli_host.board.samples import Sample
    from heli_host.link.telemetry import LinkCounters


class LiveLine:
    """Shows what is happening; a context manager. None for `is_terminal` asks standard output; ``--quiet``
    leaves only the lines that stay.

    On a terminal a table is rewritten in place; elsewhere a line is printed every few seconds.
    """

    def __init__(self, is_terminal: bool | None = None) -> None:
        self._quiet = QUIET.get()
        self._display = LiveDisplay(LINE_EVERY_S, False if self._quiet else is_terminal)

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
            self._display.print_line(f"{head} | {angles_text(sample)} | {link}")

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


def angles_text(sample: Sample) -> str:
    """Return the three angles, each with its setpoint, such as ``"elevation +4.9 (+5.0)  pitch ... deg"``."""
    from math import degrees

    from heli_host.declaration import AXES

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
