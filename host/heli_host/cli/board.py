"""Opening a board, real or simulated, from the options of the command line."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING
from urllib.parse import urlencode

from heli_host.cli.options import DEFAULT_RIG, parse_speed

if TYPE_CHECKING:
    from heli_host.heli import Heli

ARDUINO_VID = 0x2341
DUE_PROGRAMMING_PID = 0x003D
DUE_NATIVE_PID = 0x003E


@dataclass(frozen=True)
class Port:
    """A serial port of this machine.

    Parameters
    ----------
    device : str
        What ``--port`` takes.
    what : str
        The device behind it, in a person's words.
    serial_number : str
        The device's; may be empty.
    is_due : bool
        Whether it is the programming port of a Due, which this link uses.
    is_due_native : bool
        Whether it is the Due's other port, which it does not use.
    """

    device: str
    what: str
    serial_number: str
    is_due: bool
    is_due_native: bool


def list_ports() -> list[Port]:
    """Return the serial ports of this machine, a Due's programming port first.

    Returns
    -------
    list of Port
        May be empty.
    """
    from serial.tools.list_ports import comports

    found = []
    for port in comports():
        ours = port.vid == ARDUINO_VID
        is_due = ours and port.pid == DUE_PROGRAMMING_PID
        is_native = ours and port.pid == DUE_NATIVE_PID
        what = port.description if port.description != "n/a" else "serial port"
        if is_due:
            what = "Arduino Due, programming port"
        elif is_native:
            what = "Arduino Due, native port: move the cable to the programming port"
        found.append(Port(port.device, what, port.serial_number or "", is_due, is_native))
    return sorted(found, key=lambda port: (not port.is_due, not port.is_due_native, port.device))


def find_board() -> str:
    """Return the port of the only Due that is plugged in.

    Returns
    -------
    str
        A port that ``heli_host.connect`` takes.

    Raises
    ------
    PortError
        If there is none, or more than one.
    """
    from heli_host.errors import PortError

    found = list_ports()
    boards = [port.device for port in found if port.is_due]
    if len(boards) == 1:
        return boards[0]
    if boards:
        raise PortError(
            f"{len(boards)} boards are plugged in", f"choose one: --port {' or --port '.join(boards)}"
        )
    if any(port.is_due_native for port in found):
        raise PortError(
            "the Due is plugged in by its native port", "use the programming port, next to the power jack"
        )
    raise PortError(
        "no board is plugged in", "name its port with --port, or fly the simulated one with --sil"
    )


@contextlib.contextmanager
def open_board(
    port: str | None,
    sil: bool,
    rig: str = DEFAULT_RIG,
    speed: str = "1",
    seed: int = 1,
) -> Iterator[Heli]:
    """Connect to a board and disconnect at the end.

    Parameters
    ----------
    port : str or None
        A pyserial URL; None looks for the only Due.
    sil : bool
        Start a simulated board instead and connect to that.
    rig : str
        Rig of the simulated board, by name or file.
    speed : str
        Simulated seconds a second, or ``max``.
    seed : int
        Seed of the simulation.

    Yields
    ------
    Heli
        The connected board.

    Raises
    ------
    LinkError
        If there is no board, or it does not answer.
    """
    import heli_host

    with contextlib.ExitStack() as stack:
        if sil:
            factor = parse_speed(speed)
            if factor is None:
                url = "sil://?" + urlencode({"rig": rig, "seed": seed, "speed": "max"})
            else:
                # A process of its own behind a pseudo-terminal: the host talks to it exactly as to hardware.
                from heli_sim.sil.process import SilProcess

                url = stack.enter_context(SilProcess(rig=rig, speed=factor, seed=seed)).url
        else:
            url = port if port is not None else find_board()
        yield stack.enter_context(heli_host.connect(url))
