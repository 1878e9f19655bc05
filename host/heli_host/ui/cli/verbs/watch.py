"""``heli-host watch``: look at a board without commanding anything."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from heli_host.ui.cli.options import DurationOption, PortOption
from heli_host.ui.cli.say import say
from heli_host.ui.cli.simulated import RigOption, SilOption, SpeedOption, sil_address
from heli_host.ui.cli.verb import Verb

if TYPE_CHECKING:
    from heli_host.board.samples import Sample
    from heli_host.fly.heli import Heli
    from heli_host.ui.cli.live_display import LiveDisplay

STEP_S = 0.2
"""Device time between two looks."""
LINE_EVERY_S = 1.0
"""When the output goes to a file or another program."""


def watch(
    duration_s: DurationOption = None,
    port: PortOption = None,
    sil: SilOption = False,
    rig: RigOption = None,
    speed: SpeedOption = "1",
) -> None:
    """Show counts, angles, encoder errors, voltages and state, live.

    Sends no command, so that no motor starts. Turn an axis by hand, and see which counter moves, and which
    way. Ctrl-C ends it.

    Example: `heli-host watch --port /dev/ttyACM0 --duration 60`
    """
    from heli_host.ui.cli.board import board_text, open_board

    with open_board(port, sil_address(rig=rig, speed=speed) if sil else None) as heli:
        info = heli.info
        say(f"{board_text(heli)}; last start: {info.reset}; parameters: {info.params_source}")
        if info.boot_fault:
            say(f"before that start: {info.boot_fault}")
        try:
            _show_until(heli, duration_s)
        except KeyboardInterrupt:
            # Watching without --duration ends this way.
            print()


def _show_until(heli: Heli, duration_s: float | None) -> None:
    """Show the newest sample until `duration_s` has passed on the device; until Ctrl-C if it is None."""
    from heli_host.ui.cli.live_display import LiveDisplay

    with LiveDisplay(LINE_EVERY_S) as live:
        for passed_s in heli.pace(STEP_S, duration_s):
            if live.due:
                _show_sample(heli, live, passed_s)


def _show_sample(heli: Heli, live: LiveDisplay, passed_s: float) -> None:
    """Show a sample: angles, encoder counts, illegal transitions and link. Without a terminal it is one line
    of text.
    """
    from math import tau

    from heli_host.declaration import AXES
    from heli_host.errors import fault_text
    from heli_host.ui.cli.live_table import numbers_table
    from heli_host.ui.cli.progress import heading, link_text

    sample, status = heli.latest, heli.session.status()
    illegal = {axis: int(getattr(status, f"illegal_{axis}")) for axis in AXES}
    counts = {
        axis: round(getattr(sample, f"{axis}_rad") / tau * abs(heli.params[f"{axis}_counts_per_rev"]))
        for axis in AXES
    }
    if not live.is_terminal:
        live.print_line(line(sample, counts, illegal))
        return
    fault = fault_text(sample.fault) if sample.fault else ""
    live.replace(
        heading(sample, passed_s, "watching", None),
        numbers_table(sample, counts, illegal),
        *([fault] if fault else []),
        f"link: {link_text(heli.counters)}",
    )


def line(sample: Sample, counts: Mapping[str, int], illegal: Mapping[str, int]) -> str:
    """Say in one line what a board measures and does: for each axis counts, degrees and illegal transitions;
    then voltages, state and fault.
    """
    axes = [
        f"{axis} {counts[axis]:+6d} ({getattr(sample, f'{axis}_deg'):+7.2f} deg, {illegal[axis]} bad)"
        for axis in counts
    ]
    fault = f", fault {sample.fault.name.lower()}" if sample.fault else ""
    volts = f"front {sample.front_V:+.2f} V, back {sample.back_V:+.2f} V"
    return f"{'  '.join(axes)}  {volts}  {sample.state.name.lower()}{fault}"


VERB = Verb(watch, "Fly")
