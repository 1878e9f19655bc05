"""``heli-host motors``: fixed voltages on the bench, without any control."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from heli_host.ui.cli.options import ClearFaultOption, PortOption
from heli_host.ui.cli.say import say
from heli_host.ui.cli.simulated import RigOption, SilOption, SpeedOption, sil_address
from heli_host.ui.cli.verb import Verb

if TYPE_CHECKING:
    from heli_host.fly.heli import Heli

MAX_S = 30.0
# The board switches the motors off if no open-loop message arrives for setpoint_hold_s (0.5 s).
REFRESH_S = 0.1


def motors(
    front_V: Annotated[
        float, typer.Option("--front-V", metavar="V", help="Drive the front motor with this voltage.")
    ] = 0.0,
    back_V: Annotated[
        float, typer.Option("--back-V", metavar="V", help="Drive the back motor with this voltage.")
    ] = 0.0,
    duration_s: Annotated[
        float,
        typer.Option("--duration", metavar="S", min=0.1, max=MAX_S, help="Drive for this time in s."),
    ] = 2.0,
    clear_fault: ClearFaultOption = False,
    port: PortOption = None,
    sil: SilOption = False,
    rig: RigOption = None,
    speed: SpeedOption = "1",
) -> None:
    """Drive the motors with fixed voltages on the bench, then switch them off.

    This enables the drivers of a real board. Use no propellers before docs/how-to/first-power-up.md allows
    them, because nothing holds the arm. Without voltages it only enables the drivers. Ctrl-C switches off
    immediately. The board itself switches off if this program ends.

    Example: `heli-host motors --port /dev/ttyACM0 --front-V 1.0 --duration 2`
    """
    from heli_host.board.setpoints import check_voltages
    from heli_host.ui.cli.board import clear_latched_fault, open_board

    with open_board(port, sil_address(rig=rig, speed=speed) if sil else None) as heli:
        if clear_fault:
            clear_latched_fault(heli)
        check_voltages(front_V, back_V, heli.params)
        heli.arm()
        try:
            _apply_voltages(heli, front_V, back_V, duration_s)
        finally:
            heli.stop()
        say(f"front {front_V:g} V, back {back_V:g} V for {duration_s:g} s; drivers off again")


def _apply_voltages(heli: Heli, front_V: float, back_V: float, duration_s: float) -> None:
    """Apply constant motor voltages for a time, by a command every `REFRESH_S`, because the board switches
    the motors off without one.
    """
    from heli_host.declaration import Axes, State
    from heli_host.errors import CommandRefused, FlightAborted, fault_text

    for _ in heli.pace(REFRESH_S, duration_s):
        try:
            heli.control(Axes(0), front_V, back_V)
        except CommandRefused as refused:
            # Telemetry reports the kind of fault slightly later.
            heli.wait(REFRESH_S)
            if heli.state is not State.FAULT:
                raise
            raise FlightAborted(f"the board switched the motors off: {fault_text(heli.fault)}") from refused


VERB = Verb(motors, "Board")
