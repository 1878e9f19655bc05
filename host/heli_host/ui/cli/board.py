"""Opening a board, real or simulated, from the options of the command line."""

from __future__ import annotations

import contextlib
import math
import os
from collections.abc import Iterator
from typing import TYPE_CHECKING

import typer

if TYPE_CHECKING:
    from heli_host.board.heli import Heli
    from heli_host.board.telemetry import BoardInfo
    from heli_host.link.transport import PortInfo

ARDUINO_VIDS = (0x2341, 0x2A03)
"""Vendors of a Due: arduino.cc and the former arduino.org."""
DUE_PROGRAMMING_PID = 0x003D
DUE_NATIVE_PID = 0x003E


def is_due(port: PortInfo) -> bool:
    """Return whether a port is the programming port of a Due, which this link uses."""
    return port.vendor_id in ARDUINO_VIDS and port.product_id == DUE_PROGRAMMING_PID


def is_due_native(port: PortInfo) -> bool:
    """Return whether a port is the native port of a Due, which this link does not use."""
    return port.vendor_id in ARDUINO_VIDS and port.product_id == DUE_NATIVE_PID


def check_target(port: str | None, sil: bool | None) -> None:
    """Check that the options of a verb name exactly one board."""
    # HELI_PORT is a lasting setting: --sil overrides it, and contradicts only a --port that was typed.
    if sil and port is not None and port != os.environ.get("HELI_PORT"):
        raise typer.BadParameter("--port and --sil name two different boards; leave one of them out")
    if sil or port is not None:
        return
    from heli_host.errors import PortError
    from heli_host.link.transport import available_ports

    ports = available_ports()
    boards = [available.device for available in ports if is_due(available)]
    simulation = "" if sil is None else "--sil for the simulation, or "
    if len(boards) == 1:
        remedy = f"add {simulation}--port {boards[0]} for the Due found there"
    elif boards:
        named = " or ".join(f"--port {device}" for device in boards)
        remedy = f"add {simulation}{named} for one of the {len(boards)} Dues found"
    elif any(is_due_native(available) for available in ports):
        raise PortError(
            "no board is named, and the Due is plugged in by its native port",
            "move its cable to the programming port, next to the power jack, "
            f"then add {simulation}--port PORT",
        )
    else:
        remedy = f"add {simulation}--port PORT once a board is plugged in; heli-host ports lists ports"
    absence = "" if boards else ", and no Due is plugged in"
    raise PortError(f"no board is named{absence}", remedy)


@contextlib.contextmanager
def open_board(port: str | None, sil: str | None = None) -> Iterator[Heli]:
    """Connect to the board that the options name and disconnect at the end."""
    import heli_host

    check_target(port, sil is not None)
    url = sil if sil is not None else port
    assert url is not None
    with heli_host.connect(url) as heli:
        _say_migration(heli)
        yield heli


def _say_migration(heli: Heli) -> None:
    """Print a warning if the board's stored parameters are not all in force."""
    from heli_host.board.parameters import migration_text, read_origin
    from heli_host.ui.cli.say import say_progress

    if heli.info.params_source == "migrated":
        say_progress(f"warning: {migration_text(read_origin(heli.session))}")


def check_board_rig(heli: Heli, rig: str | None, *, blind: bool = False) -> None:
    """Compare the parameters of a board with the rig that it flies; print a warning for each difference.

    Nothing that is printed of a `blind` flight has the numbers or the name of the simulated rig.
    """
    from heli_host.board.parameters import spec_of
    from heli_host.board.rig_check import GAINS_RIG, check_rig, is_known_rig, rig_parameters
    from heli_host.link.transport import transport_rig_parameters
    from heli_host.ui.cli.say import say, say_progress

    expected = transport_rig_parameters(heli.session.transport)
    simulated = bool(expected)
    directed: frozenset[str] = frozenset()
    if rig is not None and not simulated:
        if not is_known_rig(rig):
            say_progress(f"rig {rig} is a label, not a rig file: the board's parameters are not compared")
            return
        parameters = rig_parameters(rig)
        expected, directed = parameters.values, parameters.directed
    for difference in check_rig(expected, heli.params, simulated=simulated, directed=directed):
        # A simulated board starts with the parameters of its rig, so the user has set this one on purpose.
        fix = "" if simulated else f"; heli-host params set {difference.parameter} {difference.rig:g} --save"
        say(
            f"warning: {difference.parameter} is not that of the rig"
            if blind
            else f"warning: {difference}{fix}"
        )
    has_default_gains = math.isclose(heli.params["hover_V"], spec_of("hover_V").default, rel_tol=1e-6)
    if simulated and has_default_gains and rig not in (None, GAINS_RIG) and not blind:
        say_progress(
            f"note: the board's gains are for {GAINS_RIG}; heli-host tune --rig {rig} designs others"
        )


def clear_latched_fault(heli: Heli) -> None:
    """Clear a fault that an earlier flight has left; no fault is no error."""
    from heli_host.declaration import State
    from heli_host.errors import fault_text
    from heli_host.ui.cli.say import say

    if heli.state is State.FAULT:
        say(f"cleared: {fault_text(heli.fault)}")
        heli.clear_fault()


def board_text(heli: Heli, *, hidden: bool = False) -> str:
    """Return a description of the board, such as ``"Arduino Due, firmware 0.1.0, on /dev/ttyACM0"``."""
    # If `hidden`, the description does not contain the address.
    from heli_host.link.transport import transport_label

    info, transport = heli.info, heli.session.transport
    kind = transport_label(transport) or ("simulated board" if info.board == "native" else info.board)
    address_text = "address hidden" if hidden else f"on {transport.url}"
    return f"{kind}, firmware {info.firmware_version}, {address_text}"


def board_versions(info: BoardInfo) -> str:
    """Return board, firmware and link version, such as ``"Arduino Due, firmware 0.1.0, link 1.0"``."""
    return f"{info.board}, firmware {info.firmware_version}, link {info.link_version}"
