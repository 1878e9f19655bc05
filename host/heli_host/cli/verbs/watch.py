"""``heli-host watch``: look at a board without commanding anything."""

from __future__ import annotations

import sys
import time
from typing import TYPE_CHECKING

from heli_host.cli.options import ForOption, PortOption
from heli_host.cli.simulated import RigOption, SilOption, SpeedOption, sil_address
from heli_host.cli.verb import Verb

if TYPE_CHECKING:
    from heli_host.heli import Heli

STEP_S = 0.2
"""Device time between two looks."""
LINE_EVERY_S = 1.0
"""When the output goes to a file or another program."""


def watch(
    for_s: ForOption = None,
    port: PortOption = None,
    sil: SilOption = False,
    rig: RigOption = None,
    speed: SpeedOption = "1",
) -> None:
    """Show counts, angles, encoder errors, voltages and state, live. Commands nothing: no motor runs.

    For the bench: turn an axis by hand and see which counter moves, and which way.

    Example: `heli-host watch --for-s 60`
    """
    from heli_host.cli.board import board_text, open_board

    with open_board(port, sil_address(rig=rig, speed=speed) if sil else None) as heli:
        info = heli.info
        print(f"{board_text(heli)}; last start: {info.reset}; parameters: {info.params_source}")
        if info.boot_fault:
            print(f"before that start: {info.boot_fault}")
        try:
            _look(heli, for_s)
        except KeyboardInterrupt:
            # This is how watching without --for-s is meant to end.
            print()


def _look(heli: Heli, for_s: float | None) -> None:
    start_s = heli.latest.t_s
    passed_s = 0.0
    is_terminal = sys.stdout.isatty()
    shown_s = float("-inf")
    shown = False
    while for_s is None or passed_s < for_s:
        heli.wait(STEP_S if for_s is None else min(STEP_S, for_s - passed_s))
        passed_s = heli.latest.t_s - start_s
        if is_terminal:
            print(f"\r\x1b[2K{line(heli)}", end="", flush=True)
        elif time.monotonic() - shown_s >= LINE_EVERY_S:
            print(line(heli), flush=True)
            shown_s = time.monotonic()
        shown = True
    if is_terminal and shown:
        print()


def line(heli: Heli) -> str:
    """Say in one line what a board measures and does: for each axis counts, degrees and illegal transitions;
    then voltages, state and fault.
    """
    from math import tau

    from heli_host.declaration import AXES

    sample, status = heli.latest, heli.session.status()
    axes = []
    for axis in AXES:
        angle_rad, illegal = getattr(sample, f"{axis}_rad"), getattr(status, f"illegal_{axis}")
        counts = round(angle_rad / tau * abs(heli.params[f"{axis}_counts_per_rev"]))
        axes.append(f"{axis} {counts:+6d} ({angle_rad * 360.0 / tau:+7.2f} deg, {illegal} bad)")
    fault = f", fault {sample.fault.name.lower()}" if sample.fault else ""
    volts = f"front {sample.front_V:+.2f} V, back {sample.back_V:+.2f} V"
    return f"{'  '.join(axes)}  {volts}  {sample.state.name.lower()}{fault}"


VERB = Verb(watch, "Fly")
