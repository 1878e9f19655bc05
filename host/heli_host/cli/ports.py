"""``heli-host ports``: which serial ports there are."""

from __future__ import annotations


def ports() -> None:
    """List the serial ports, the Due's programming port first.

    Example: `heli-host ports`
    """
    from rich.console import Console
    from rich.table import Table

    from heli_host.cli.board import list_ports

    found = list_ports()
    console = Console(highlight=False)
    if not found:
        console.print(
            "no serial port found; plug the board in (its programming port, next to the power jack)"
        )
        return
    table = Table("port", "what", "serial number", box=None, pad_edge=False)
    for port in found:
        table.add_row(port.device, port.what, port.serial_number)
    console.print(table)
